# SPDX-License-Identifier: Apache-2.0
"""Reads what identification is given: bags or a lab's folder, and the bench tests."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from worm_model.arrays import Array
from worm_model.bags.lab_logs import LabError, LabSettings, read_columns, read_lab_run
from worm_model.bags.opening import open_bag
from worm_model.bags.run_reader import read_run
from worm_model.identification import bellows, fin
from worm_model.identification.identification_errors import IdentificationError
from worm_model.identification.observed_run import Recording, recordings_of
from worm_model.run import utc_of

RUN_FILE = "camera.csv"  # by which a run of a lab is known
BELLOWS_FILE, FIN_FILE = "bellows.csv", "fin.csv"
EPOCH = 10**9  # ns; logs of a lab carry no date, and a stamp of 0 means "unknown"
LOGS = LabSettings(epoch=EPOCH)
TOPICS = (
    "body_length/commanded",
    "body_length/cable",
    "tracker",
    "power",
    "gait_state",
)
SEVERAL_LABS = (
    "runs of several folders ({}): their README.md and bench tests are not used; name --parameters, --bellows "
    "and --fin"
)
_BLOCK = 1 << 20


@dataclass(frozen=True)
class BenchTest:
    """A table of two columns, ``x`` and ``y`` (n,) each, in SI units; the ``checksum`` of its file."""

    x: Array
    y: Array
    checksum: str


@dataclass(frozen=True)
class Inputs:
    """The recordings and the bench tests, None where there is none; ``folder`` of a lab, None for bags.

    ``remarks`` in words on what was found but not used.
    """

    recordings: tuple[Recording, ...]
    bellows: BenchTest | None
    fin: BenchTest | None
    folder: Path | None
    remarks: tuple[str, ...] = ()


def read_inputs(
    paths: Sequence[Path],
    bellows_file: Path | None = None,
    fin_file: Path | None = None,
    definitions: Path | None = None,
    logs: LabSettings = LOGS,
) -> Inputs:
    """Bags, and a lab's folders or runs of them; one lab's own bench tests are used unless others are named.

    ``definitions`` of messages are as `open_bag` takes them, ``logs`` holds what a lab's logs do not say. Raises
    `IdentificationError`, or `worm_model.bags.bag_errors.BagError`, if something cannot be read.
    """
    recordings = tuple(read_recordings(paths, definitions, logs))
    _check_names(recordings)
    labs = sorted({_lab_of(path) for path in paths if is_lab_folder(path)})
    folder = labs[0] if len(labs) == 1 else None
    if folder is not None:
        bellows_file = bellows_file or _existing(folder / BELLOWS_FILE)
        fin_file = fin_file or _existing(folder / FIN_FILE)
    return Inputs(
        recordings,
        read_bench_test(bellows_file, bellows.COLUMNS) if bellows_file else None,
        read_bench_test(fin_file, fin.COLUMNS) if fin_file else None,
        folder,
        (
            *([SEVERAL_LABS.format(", ".join(lab.name for lab in labs))] if len(labs) > 1 else []),
            *_told(recordings),
        ),
    )


def _told(recordings: Sequence[Recording]) -> list[str]:
    """The remarks of recordings, each once, behind the names that it is of."""
    names: dict[str, list[str]] = {}
    for recording in recordings:
        for remark in recording.remarks:
            names.setdefault(remark, []).append(recording.name)
    every = len(recordings)
    return [
        f"{'all runs' if len(of) == every > 1 else ', '.join(of)}: {remark}"
        for remark, of in names.items()
    ]


def read_recordings(
    paths: Sequence[Path], definitions: Path | None = None, logs: LabSettings = LOGS
) -> list[Recording]:
    """The runs in bags and in a lab's folders, each of which may hold several, in the order of their names there."""
    recordings = []
    for path in paths:
        if is_lab_folder(path):
            recordings += [read_lab_recording(run, logs) for run in run_folders(path)]
        else:
            recordings += _read_bag(path, definitions)
    return recordings


def _lab_of(path: Path) -> Path:
    """Where a lab keeps what its runs have in common: beside a run, in a folder of runs."""
    folder = path.resolve()
    return folder.parent if (folder / RUN_FILE).is_file() else folder


def is_lab_folder(path: Path) -> bool:
    """Whether a path holds a lab's runs rather than being a bag."""
    return path.is_dir() and bool(run_folders(path))


def run_folders(folder: Path) -> list[Path]:
    """Folders of a lab's runs, by name; the folder itself if it is one."""
    if (folder / RUN_FILE).is_file():
        return [folder]
    return sorted(file.parent for file in folder.glob(f"*/{RUN_FILE}"))


def _read_bag(path: Path, definitions: Path | None) -> tuple[Recording, ...]:
    """The runs in a bag."""
    with open_bag(path, definitions=definitions) as bag:
        run = read_run(bag, names=TOPICS)
        start = bag.start
    files = [path] if path.is_file() else sorted(f for f in path.iterdir() if f.is_file())
    checksums = {file.name: _checksum(file) for file in files}
    return recordings_of(run, path.resolve().name, checksums, utc_of(start))


def read_lab_recording(folder: Path, logs: LabSettings = LOGS) -> Recording:
    """The run in a lab's folder."""
    try:
        lab = read_lab_run(folder, logs)
    except LabError as error:
        raise IdentificationError(str(error)) from None
    if lab.gait is None:
        raise IdentificationError(
            f"{folder}: no runs.json tells the gait; add one with stroke_m and frequency_Hz of each run"
        )
    recording = recordings_of(lab.run, folder.resolve().name, lab.checksums)[0]
    return replace(recording, remarks=(*lab.transmission.remarks, *recording.remarks))


def read_bench_test(path: Path, columns: tuple[str, str]) -> BenchTest:
    """A bench test of two columns, in any order of its rows."""
    try:
        table = read_columns(path, columns)
    except LabError as error:
        raise IdentificationError(str(error)) from None
    return BenchTest(table[columns[0]], table[columns[1]], _checksum(path))


def _checksum(path: Path) -> str:
    """SHA-256 of a file."""
    digest = hashlib.sha256()
    with path.open("rb") as stream:
        while block := stream.read(_BLOCK):
            digest.update(block)
    return digest.hexdigest()


def _existing(path: Path) -> Path | None:
    return path if path.is_file() else None


def _check_names(recordings: Sequence[Recording]) -> None:
    names = [recording.name for recording in recordings]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise IdentificationError(f"two runs are called {twice[0]}: rename one of them")
