# SPDX-License-Identifier: Apache-2.0
"""A recorded gait with all that a report tells about it."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from worm_model.analysis.replay_metrics import ReplayReport, report_replay
from worm_model.commands.command_line import InputError
from worm_model.gait import Gait, GaitError
from worm_model.parameters import (
    ParameterFile,
)
from worm_model.run import GaitStates, Run
from worm_model.simulation.simulator import cost_of_transport
from worm_model.twin.offline_replay import Replay
from worm_optimizer.operation.gait_figures import (
    AVERAGED_CYCLES,
    Array,
    RecordingError,
    Stamps,
    Window,
    accumulate,
    mean_rate,
)
from worm_optimizer.report.events import Event
from worm_optimizer.report.expectation import Band, Bands, Expectation, expect
from worm_optimizer.report.parts import Part

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


def recorded_gait(
    part: Part,
    name: str,
    replay: Replay,
    parameters: tuple[ParameterFile, str],
    events: tuple[Event, ...],
    provenance: dict[str, str],
) -> RecordedGait:
    """Judges one gait by its part of a recording and of the twin's replay, and predicts it.

    ``parameters`` are the file's content and where it comes from. Raises InputError if the part holds no gait.
    """
    run = part.run
    content, source = parameters
    gait, onset, cycles = _last_gait(run.gait_state, name)
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
        events=events,
        missing=tuple(missing),
        provenance=provenance,
    )


def _last_gait(states: GaitStates, name: str) -> tuple[Gait, int, int]:
    """The last gait that was played, its onset (ns) and its cycles."""
    rows = np.flatnonzero(states.played)
    if not rows.size:
        raise InputError(
            f"{name}: holds no gait that was run; record one with the topic gait_state"
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
        raise InputError(f"{name}: {error}") from None
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
