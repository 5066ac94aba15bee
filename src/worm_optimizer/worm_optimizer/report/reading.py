# SPDX-License-Identifier: Apache-2.0
"""Reads recordings for a report: bags in, recorded gaits out."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import yaml

from worm_model.bags.bag import Bag
from worm_model.bags.opening import open_bag
from worm_model.bags.run_reader import read_run
from worm_model.commands.command_line import InputError
from worm_model.parameters import (
    ParameterError,
    ParameterFile,
    load_parameter_file,
    parse_parameter_file,
)
from worm_model.run import Run
from worm_model.twin.offline_replay import Replay, replay_run
from worm_optimizer.report.events import events_of
from worm_optimizer.report.parts import cut_replay, joined, last_stamp, parts_of
from worm_optimizer.report.recorded import RecordedGait, recorded_gait

_ATTACHED = "parameters.yaml"  # the recorder's name for the run's parameter file
_MANIFEST = "worm_run"
_PAPER = "the paper's values"
_CHUNK = 1 << 20
# Recordings that follow each other within so long, the robot where it was: nobody has touched it.
_LONGEST_BREAK_NS = 60_000_000_000
_UNMOVED = 3e-3  # m
_AT_REST = 10  # samples of the tracker


@dataclass(frozen=True)
class _Recording:
    """An open bag, with the parameters that it is compared with and where these come from."""

    bag: Bag
    name: str
    run: Run
    parameters: tuple[ParameterFile, str]
    provenance: dict[str, str]


def read_recorded_gaits(
    paths: Sequence[Path], parameters: str, notify: Callable[[str], None]
) -> list[RecordedGait]:
    """Reads bags, lets the twin follow their gaits, and predicts each, all in the order of the bags.

    The twin goes on from one recording to the next where the robot did: a gait leaves the fins bent, and the next one
    begins from there. ``parameters`` is a parameter file; empty: the one inside the bag, else the paper's. Raises
    BagError, ParameterError, or InputError if a bag holds no gait.
    """
    with ExitStack() as opened:
        recordings = [
            _recording(opened.enter_context(open_bag(path, notify)), path, parameters)
            for path in paths
        ]
        found = {}
        for group in _unbroken(recordings):
            run = joined([recording.run for recording in group])
            whole = replay_run(run, group[0].parameters[0].parameters)
            for recording in group:
                found[id(recording)] = list(_gaits_of(recording, whole, notify))
    return _named_apart([gait for recording in recordings for gait in found[id(recording)]])


def _recording(bag: Bag, path: Path, parameters: str) -> _Recording:
    used = _parameters_of(bag, parameters)
    name = path.stem if path.is_file() else path.resolve().name
    return _Recording(bag, name, read_run(bag), used, _provenance(bag, path, used[1]))


def _unbroken(recordings: Sequence[_Recording]) -> list[list[_Recording]]:
    """Recordings by the time of their start, together where one goes on from the other."""
    groups: list[list[_Recording]] = []
    for recording in sorted(recordings, key=lambda each: each.run.origin):
        if groups and _goes_on(groups[-1][-1], recording):
            groups[-1].append(recording)
        else:
            groups.append([recording])
    return groups


def _goes_on(before: _Recording, after: _Recording) -> bool:
    """Whether a robot was left alone between two recordings."""
    if before.parameters[0] != after.parameters[0]:
        return False
    left, found = before.run.tracker.rear_position, after.run.tracker.rear_position
    left, found = left[np.isfinite(left)][-_AT_REST:], found[np.isfinite(found)][:_AT_REST]
    if not (left.size and found.size):
        return False
    pause = after.run.origin - last_stamp(before.run)
    unmoved = abs(np.median(found) - np.median(left)) < _UNMOVED
    return before.run.origin < after.run.origin and pause < _LONGEST_BREAK_NS and bool(unmoved)


def _gaits_of(
    recording: _Recording, whole: Replay, notify: Callable[[str], None]
) -> Iterator[RecordedGait]:
    parts = parts_of(recording.run)
    if len(parts) > 1:
        notify(f"{recording.bag.path} holds {len(parts)} gaits, each is reported")
    for number, part in enumerate(parts, 1):
        name = f"{recording.name}_{number}" if len(parts) > 1 else recording.name
        replay = cut_replay(whole, part)
        events = events_of(recording.bag, part, replay)
        yield recorded_gait(part, name, replay, recording.parameters, events, recording.provenance)


def _named_apart(gaits: Sequence[RecordedGait]) -> list[RecordedGait]:
    """The same gaits, those of one name numbered."""
    names = [gait.name for gait in gaits]
    return [
        replace(gait, name=f"{gait.name} ({names[: row + 1].count(gait.name)})")
        if names.count(gait.name) > 1
        else gait
        for row, gait in enumerate(gaits)
    ]


def _parameters_of(bag: Bag, given: str) -> tuple[ParameterFile, str]:
    if given:
        return load_parameter_file(given), given
    for attached in bag.attachments():
        if attached.name == _ATTACHED:
            try:
                content = parse_parameter_file(yaml.safe_load(attached.data))
            except (ParameterError, yaml.YAMLError) as error:
                raise InputError(
                    f"{bag.path}: its parameter file cannot be used ({error}); give --parameters"
                ) from None
            return content, "the parameter file inside the recording"
    return ParameterFile(), _PAPER


def _provenance(bag: Bag, path: Path, source: str) -> dict[str, str]:
    """What the recording says of itself, its files' hashes, and what it was compared with."""
    files = [path] if path.is_file() else sorted(f for f in path.iterdir() if f.is_file())
    hashes = {f"sha256 of {file.name}": _sha256(file) for file in files}
    manifest = {key: value for key, value in bag.metadata.get(_MANIFEST, {}).items() if value}
    return {"recording": str(path), **hashes, "compared with": source, **manifest}


def _sha256(path: Path) -> str:
    digest = hashlib.sha256()
    with path.open("rb") as file:
        while chunk := file.read(_CHUNK):
            digest.update(chunk)
    return digest.hexdigest()
