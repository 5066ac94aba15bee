# SPDX-License-Identifier: Apache-2.0
"""Selection of bags for a report, and their conversion to a `RecordedGait` for each gait that was played."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from worm_model.analysis.run_parts import last_stamp, parts_of
from worm_model.bags.formats.bag_errors import BagError
from worm_model.bags.formats.finding import METADATA_FILE
from worm_model.bags.opening import Bag, open_bag
from worm_model.bags.recording.run_manifest import (
    RUN_RECORD,
    recorded_conditions,
    recorded_parameters,
    recorded_robot,
)
from worm_model.bags.run_reader import read_run
from worm_model.checksum import checksums_of
from worm_model.errors import InputError
from worm_model.parameters import ParameterFile
from worm_model.run import Run
from worm_model.twin.offline_replay import Replay, Series, replay_run
from worm_optimizer.report.events import events_of
from worm_optimizer.report.recorded_gait import RecordedGait, recorded_gait

_PAPER = "the paper's values"
_INSIDE = "the parameter file inside the recording"


def bags_of(path: Path) -> list[Path]:
    """Return the bags in a folder such as that of a campaign, sorted by the time at which they were closed.

    If ``path`` is itself a bag, or contains none, it is the only element.
    """
    inside = [] if (path / METADATA_FILE).exists() else list(path.glob(f"*/{METADATA_FILE}"))
    return [file.parent for file in sorted(inside, key=_closed)] or [path]


def newest_recording(folder: Path, notify: Callable[[str], None]) -> Path:
    """Return the bag with the newest recording of a gait, or the folder of bags that contains it.

    Args:
        folder: folder that is searched. It contains bags, or folders of bags such as that of a campaign.
        notify: function that is called with the reason for each bag that is skipped.
    """
    bags = [*folder.glob(f"*/{METADATA_FILE}"), *folder.glob(f"*/*/{METADATA_FILE}")]
    for metadata in sorted(bags, key=_closed, reverse=True):
        if _holds_gait(metadata.parent, notify):
            return folder / metadata.relative_to(folder).parts[0]
    raise InputError(
        f"no recording of a gait in {folder.resolve()}: give the path of a bag, or record one (./worm demo)"
    )


def _holds_gait(path: Path, notify: Callable[[str], None]) -> bool:
    try:
        with open_bag(path, notify) as bag:
            states = read_run(bag, names=("gait_state",)).gait_state
    except BagError as error:
        notify(f"skipped: {error}")
        return False
    played = bool(states.played.any())
    if not played:
        notify(f"skipped: {path} contains no gait")
    return played


def _closed(metadata: Path) -> tuple[float, str]:
    """Return the sort key of a bag: the time at which it was closed, then its path."""
    return metadata.stat().st_mtime, str(metadata)


def read_recorded_gaits(
    paths: Sequence[Path], parameters: str, notify: Callable[[str], None]
) -> list[RecordedGait]:
    """Read bags, replay their gaits with the twin, and predict each gait.

    The gaits are in the order of the bags.

    Args:
        paths: bags.
        parameters: parameter file. An empty string selects the parameters in the bag, or the paper's values for a bag
            without parameters.
        notify: function that is called with each remark on the recordings.
    """
    gaits: list[RecordedGait] = []
    for path in paths:
        with open_bag(path, notify) as bag:
            gaits += _gaits_of(bag, path, parameters, notify)
    _check_one_form(gaits)
    return _named_apart(gaits)


def _check_one_form(gaits: Sequence[RecordedGait]) -> None:
    """Raise `InputError` if the expected powers of the gaits are not comparable with each other."""
    names = {gait.content.parameters.one_sided_cable: gait.name for gait in gaits}
    if len(names) > 1:
        raise InputError(
            f"{names[True]} was recorded with parameters of a cable that cannot push (one_sided_cable), {names[False]} "
            "was not: give one parameter file for both with --parameters FILE, or make a report for each"
        )


def _gaits_of(
    bag: Bag, path: Path, parameters: str, notify: Callable[[str], None]
) -> Iterator[RecordedGait]:
    run, (content, source) = read_run(bag), _parameters_of(bag, parameters)
    whole = replay_run(run, content.parameters)
    provenance = _provenance(bag, path, source)
    recording = path.stem if path.is_file() else path.resolve().name
    parts = parts_of(run)
    if len(parts) > 1:
        notify(f"{bag.path} contains {len(parts)} gaits, which are reported separately")
    for number, part in enumerate(parts, 1):
        name = f"{recording}_{number}" if len(parts) > 1 else recording
        replay = _cut_replay(whole, part.run)
        events = events_of(bag, part.run, part.holds, replay)
        yield recorded_gait(part.run, name, replay, (content, source), events, provenance)


def _named_apart(gaits: Sequence[RecordedGait]) -> list[RecordedGait]:
    """Return the gaits with unique names: a name that occurs more than once gets a number."""
    names = [gait.name for gait in gaits]
    return [
        replace(gait, name=f"{gait.name} ({names[: row + 1].count(gait.name)})")
        if names.count(gait.name) > 1
        else gait
        for row, gait in enumerate(gaits)
    ]


def _parameters_of(bag: Bag, file: str) -> tuple[ParameterFile, str]:
    content = recorded_robot(bag, file)
    form = " (a cable that cannot push)" if content.parameters.one_sided_cable else ""
    inside = _PAPER if recorded_parameters(bag) is None else _INSIDE
    return content, (file or inside) + form


def _provenance(bag: Bag, path: Path, source: str) -> dict[str, str]:
    """Return the manifest of the recording, the hashes of its files, and the origin of the parameters."""
    hashes = {f"sha256 of {name}": checksum for name, checksum in checksums_of(path).items()}
    manifest = {key: value for key, value in bag.metadata.get(RUN_RECORD, {}).items() if value}
    return {
        "recording": str(path),
        **hashes,
        "compared with": source,
        "conditions": str(recorded_conditions(bag)),
        **manifest,
    }


def _cut_replay(replay: Replay, run: Run) -> Replay:
    """Return the twin's output for a part of a recording, from its first sample to its last."""
    start, end = run.origin, last_stamp(run)

    def cut(series: Series) -> Series:
        rows = (series["stamp_ns"] >= start) & (series["stamp_ns"] <= end)
        return {name: column[rows] for name, column in series.items()}

    return replace(
        replay,
        states=cut(replay.states),
        residuals=cut(replay.residuals),
        lengths=cut(replay.lengths),
        notices=tuple(notice for notice in replay.notices if start <= notice.stamp_ns <= end),
    )
