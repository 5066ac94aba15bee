# SPDX-License-Identifier: Apache-2.0
"""Inputs of the identification: bags or a lab's folder, and the bench tests."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from worm_model.arrays import Array
from worm_model.bags.opening import open_bag
from worm_model.bags.recording.run_manifest import recorded_conditions
from worm_model.bags.run_reader import read_run
from worm_model.checksum import checksums_of, sha256_of
from worm_model.errors import IdentificationError
from worm_model.identification import bellows, fin
from worm_model.identification.data.lab_logs import (
    LabSettings,
    read_columns,
    read_lab_run,
)
from worm_model.identification.data.observed_run import Recording, recordings_of
from worm_model.run import utc_of
from worm_msgs.conditions import LEVEL

RUN_FILE = "camera.csv"  # a folder with this file is a run of a lab
BELLOWS_FILE, FIN_FILE = "bellows.csv", "fin.csv"
TOPICS = ("body_length/commanded", "tracker", "power", "gait_state")
SEVERAL_LABS = (
    "runs of several folders ({}): their README.md and bench tests are not used; give --parameters, --bellows "
    "and --fin"
)


@dataclass(frozen=True)
class BenchTest:
    """Table of two columns ``x`` and ``y``, shape (n,), in SI units, with the ``checksum`` of its file."""

    x: Array
    y: Array
    checksum: str


@dataclass(frozen=True)
class Inputs:
    """Recordings and bench tests (None if missing).

    ``folder`` is the folder of the lab whose runs were read; None if the runs come from no lab or from several.
    ``remarks`` name data that are not used, and assumptions.
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
) -> Inputs:
    """Read bags and folders or runs of a lab.

    If all logs belong to one lab, the bench tests in the lab's folder are used unless others are given.

    Args:
        paths: bags, folders of a lab or single runs of it.
        bellows_file, fin_file: bench tests.

    Raises:
        IdentificationError: A file is missing or invalid, or two runs have the same name.
        BagError: A bag cannot be read.
    """
    recordings = tuple(read_recordings(paths))
    _check_names(recordings)
    labs = sorted({_lab_of(path) for path in paths if run_folders(path)})
    folder = labs[0] if len(labs) == 1 else None
    remarks = _grouped_remarks(recordings)
    if len(labs) > 1:
        remarks.insert(0, SEVERAL_LABS.format(", ".join(lab.name for lab in labs)))
    return Inputs(
        recordings,
        _bench_test(bellows_file, folder, BELLOWS_FILE, bellows.COLUMNS),
        _bench_test(fin_file, folder, FIN_FILE, fin.COLUMNS),
        folder,
        tuple(remarks),
    )


def _grouped_remarks(recordings: Sequence[Recording]) -> list[str]:
    """Return each remark once, prefixed by the names of its recordings."""
    names: dict[str, list[str]] = {}
    for recording in recordings:
        for remark in recording.remarks:
            names.setdefault(remark, []).append(recording.name)
    every = len(recordings)
    return [
        f"{'all runs' if len(of) == every > 1 else ', '.join(of)}: {remark}"
        for remark, of in names.items()
    ]


def read_recordings(paths: Sequence[Path]) -> list[Recording]:
    """Read all runs in bags and in a lab's folders; each path may contain several runs."""
    recordings: list[Recording] = []
    for path in paths:
        if runs := run_folders(path):
            recordings += map(read_lab_recording, runs)
        else:
            recordings += read_bag(path)
    return recordings


def _lab_of(path: Path) -> Path:
    """Return the folder with a lab's common files: the parent if ``path`` is a run, otherwise ``path`` itself."""
    folder = path.resolve()
    return folder.parent if (folder / RUN_FILE).is_file() else folder


def run_folders(path: Path) -> list[Path]:
    """Return the folders of the runs in a lab's folder, ordered by name; the folder itself if it is a run."""
    if (path / RUN_FILE).is_file():
        return [path]
    return sorted(file.parent for file in path.glob(f"*/{RUN_FILE}"))


def read_bag(path: Path) -> tuple[Recording, ...]:
    """Read the runs in a bag. Raises IdentificationError if they were recorded on a slope, with a tether or in flow."""
    with open_bag(path) as bag:
        conditions = recorded_conditions(bag)
        if conditions != LEVEL:
            raise IdentificationError(
                f"{path}: recorded under {conditions}, which the identification does not include; use runs on "
                "level ground, without tether and flow"
            )
        run = read_run(bag, names=TOPICS)
        start = bag.start
    return recordings_of(run, path.resolve().name, checksums_of(path), utc_of(start))


def read_lab_recording(folder: Path) -> Recording:
    """Read a run of a lab from the run's folder. Onset, spool radius and L0 are estimated, see `LabSettings`.

    Raises `IdentificationError` if a file is missing or invalid, or if the run's gait is unknown.
    """
    lab = read_lab_run(folder, LabSettings())
    if lab.gait is None:
        raise IdentificationError(
            f"{folder}: the gait is unknown; add a runs.json with stroke_m and frequency_Hz of each run"
        )
    recording = recordings_of(lab.run, folder.resolve().name, lab.checksums)[0]
    return replace(recording, remarks=(*lab.remarks, *recording.remarks))


def read_bench_test(path: Path, columns: tuple[str, str]) -> BenchTest:
    """Read the two ``columns`` of a bench test. Raises `IdentificationError` if the file cannot be used."""
    table = read_columns(path, columns)
    return BenchTest(table[columns[0]], table[columns[1]], sha256_of(path))


def _bench_test(
    given: Path | None, lab: Path | None, name: str, columns: tuple[str, str]
) -> BenchTest | None:
    """Return the given bench test, otherwise that of a lab's folder; None without either."""
    if given is None and lab is not None and (lab / name).is_file():
        given = lab / name
    return None if given is None else read_bench_test(given, columns)


def _check_names(recordings: Sequence[Recording]) -> None:
    names = [recording.name for recording in recordings]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise IdentificationError(f"two runs are called {twice[0]}: rename one of them")
