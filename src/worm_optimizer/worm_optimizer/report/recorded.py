# SPDX-License-Identifier: Apache-2.0
"""A recorded gait with all that a report tells about it."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import yaml

from worm_model.bags.bag import Bag
from worm_model.bags.opening import open_bag
from worm_model.bags.run_reader import read_run
from worm_model.command_line import InputError
from worm_model.gait import Gait, GaitError
from worm_model.parameters import (
    ParameterError,
    ParameterFile,
    load_parameter_file,
    parse_parameter_file,
)
from worm_model.replay_metrics import ReplayReport, report_replay
from worm_model.run import RUNNING, GaitStates, Run
from worm_model.simulator import cost_of_transport
from worm_model.twin.replay import Replay, replay_run
from worm_optimizer.bringup.figures import (
    AVERAGED_CYCLES,
    Array,
    RecordingError,
    Stamps,
    Window,
    accumulate,
    mean_rate,
)
from worm_optimizer.report.events import Event, events_of
from worm_optimizer.report.expectation import Band, Bands, Expectation, expect
from worm_optimizer.report.parts import Part, parts_of

_ATTACHED = "parameters.yaml"  # the recorder's name for the run's parameter file
_MANIFEST = "worm_run"
_PAPER = "the paper's values"
_CHUNK = 1 << 20


@dataclass(frozen=True)
class RecordedGait:
    """A gait of a recording.

    ``run`` is the part of the recording from the rest before the gait to that before the next one.
    ``cycles`` were asked for; ``window`` are the averaged ones, the last whole ones that were recorded.
    ``measured`` holds the averaged cycles' mean and, as bounds, the lowest and highest of these cycles; ``twin`` the
    same of the twin that was driven with the recorded lengths; ``expected`` what the model says of the command alone,
    with ``content``, the parameters of ``parameter_source``. ``missing`` says why a figure is NaN.
    """

    name: str
    run: Run
    gait: Gait
    onset: int
    cycles: int
    window: Window
    content: ParameterFile
    parameter_source: str
    replay: Replay
    judged: ReplayReport
    measured: Bands
    twin: Bands
    expected: Expectation
    events: tuple[Event, ...]
    missing: tuple[str, ...]
    provenance: dict[str, str]

    @property
    def averaged_cycles(self) -> tuple[int, int]:
        """First and last of the averaged cycles, counted from 1."""
        start, end = (
            round((stamp - self.onset) * 1e-9 * self.gait.frequency)
            for stamp in (self.window.start, self.window.end)
        )
        return start + 1, end


def read_recorded_gaits(
    path: Path, parameters: str, notify: Callable[[str], None]
) -> list[RecordedGait]:
    """Reads a bag, lets the twin follow each of its gaits from rest, and predicts them.

    ``parameters`` is a parameter file; empty: the one inside the bag, else the paper's. Raises BagError,
    ParameterError, or InputError if the bag holds no gait.
    """
    name = path.stem if path.is_file() else path.resolve().name
    with open_bag(path, notify) as bag:
        parts = parts_of(read_run(bag))
        parameters_used = _parameters_of(bag, parameters)
        provenance = _provenance(bag, path, parameters_used[1])
        if len(parts) == 1:
            return [_recorded_gait(bag, parts[0], name, parameters_used, provenance)]
        notify(f"{path} holds {len(parts)} gaits, each is reported")
        return [
            _recorded_gait(bag, part, f"{name}_{number}", parameters_used, provenance)
            for number, part in enumerate(parts, 1)
        ]


def named_apart(gaits: Sequence[RecordedGait]) -> list[RecordedGait]:
    """The same gaits, those of one name numbered."""
    names = [gait.name for gait in gaits]
    return [
        replace(gait, name=f"{gait.name} ({names[: row + 1].count(gait.name)})")
        if names.count(gait.name) > 1
        else gait
        for row, gait in enumerate(gaits)
    ]


def _recorded_gait(
    bag: Bag,
    part: Part,
    name: str,
    parameters: tuple[ParameterFile, str],
    provenance: dict[str, str],
) -> RecordedGait:
    run = part.run
    content, source = parameters
    gait, onset, cycles = _last_gait(run.gait_state, bag.path)
    replay = replay_run(run, content.parameters)
    window = _averaged_window(run, gait, onset, cycles)
    missing: list[str] = []
    mass = content.parameters.mass
    energy = accumulate(run.power.stamp, run.power.valid_power)
    tracked = (run.tracker.stamp, run.tracker.rear_position)
    states = replay.states
    followed = (states["stamp_ns"], states["rear_position"])
    return RecordedGait(
        name=name,
        run=run,
        gait=gait,
        onset=onset,
        cycles=cycles,
        window=window,
        content=content,
        parameter_source=source,
        replay=replay,
        judged=report_replay(run, replay, content.parameters.pitch),
        measured=_bands(tracked, energy, gait, window, mass, missing),
        twin=_bands(followed, (states["stamp_ns"], states["energy"]), gait, window, mass, []),
        expected=expect(gait, content),
        events=events_of(bag, part, replay),
        missing=tuple(missing),
        provenance=provenance,
    )


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


def _last_gait(states: GaitStates, path: Path) -> tuple[Gait, int, int]:
    """The last gait that was played, its onset (ns) and its cycles."""
    rows = np.flatnonzero((states.state == RUNNING) & (states.onset > 0))
    if not rows.size:
        raise InputError(
            f"{path}: holds no gait that was run; record one with the topic gait_state"
        )
    row = int(rows[-1])
    try:
        gait = Gait(
            float(states.stroke[row]),
            float(states.frequency[row]),
            int(states.direction[row]),
            float(states.margin[row]),
        )
    except GaitError as error:
        raise InputError(f"{path}: {error}") from None
    return gait, int(states.onset[row]), int(states.cycles[row])


def _averaged_window(run: Run, gait: Gait, onset: int, cycles: int) -> Window:
    """The last three whole cycles that the instruments saw: a recording may end before the gait does."""
    power = run.power.valid_power
    ends = [
        int(stamp[known][-1])
        for stamp, known in (
            (run.tracker.stamp, np.isfinite(run.tracker.rear_position)),
            (run.power.stamp, np.isfinite(power)),
        )
        if known.any()
    ]
    period = 1e9 * gait.period
    seen = math.floor((min(ends) - onset) / period) if ends else cycles
    last = max(min(cycles, seen), 1)
    first = max(last - AVERAGED_CYCLES, 0)
    return Window(onset + round(first * period), onset + round(last * period))


def _bands(
    position: tuple[Stamps, Array],
    energy: tuple[Stamps, Array],
    gait: Gait,
    window: Window,
    mass: float,
    missing: list[str],
) -> Bands:
    """Figures over the averaged cycles, their bounds those of the single cycles."""
    spans = [window, *_single_cycles(window, gait)]
    speeds = [gait.direction * rate for rate in _rates(position, spans, "position of x1", missing)]
    powers = list(_rates(energy, spans, "power", missing))
    costs = [float(cost_of_transport(v, p, mass)) for v, p in zip(speeds, powers, strict=True)]
    if math.isnan(speeds[0]) or math.isnan(powers[0]):
        costs = [math.nan] * len(spans)
    return Bands(*(_band(values) for values in (speeds, powers, costs)))


def _band(values: list[float]) -> Band:
    mean, *single = values
    return Band(mean, min(single), max(single))


def _single_cycles(window: Window, gait: Gait) -> Iterator[Window]:
    count = max(1, min(AVERAGED_CYCLES, round(window.duration * gait.frequency)))
    borders = np.linspace(window.start, window.end, count + 1).round().astype(np.int64).tolist()
    for start, end in pairwise(borders):
        yield Window(start, end)


def _rates(
    samples: tuple[Stamps, Array], spans: list[Window], name: str, missing: list[str]
) -> Iterator[float]:
    """Mean rate over each span; NaN where the samples do not reach, which ``missing`` then says once."""
    for span in spans:
        try:
            yield mean_rate(samples, span, name)
        except RecordingError as error:
            if str(error) not in missing:
                missing.append(str(error))
            yield math.nan


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
