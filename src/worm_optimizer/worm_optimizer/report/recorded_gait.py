# SPDX-License-Identifier: Apache-2.0
"""A recorded gait with all that a report says of it: measured, expected, and as the twin followed it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from worm_model.analysis.replay_metrics import ReplayReport, report_replay
from worm_model.analysis.run_metrics import (
    PlayedGait,
    RecordingError,
    Samples,
    Window,
    accumulated_energy,
    averaged_cycles,
    early_end,
    idle_power,
    last_played_gait,
    mean_rate,
    single_cycles,
)
from worm_model.gait import Gait
from worm_model.parameters import ParameterFile
from worm_model.run import Run
from worm_model.simulation.simulator import cost_of_transport
from worm_model.twin.offline_replay import Replay
from worm_optimizer.report.events import Event
from worm_optimizer.report.expectation import Band, Bands, Expectation, expect


@dataclass(frozen=True)
class RecordedGait:
    """A gait of a recording.

    ``run`` is the part of the recording from the rest before the gait to that before the next one.
    ``averaged_cycles`` (first and last, counted from 1) are the last whole ones that were played and recorded.
    ``measured`` holds their mean and, as bounds, the lowest and highest of these cycles; ``twin`` the same of the twin
    that was driven with the recorded lengths; ``expected`` what the model says of these cycles from the command alone,
    with ``content``, the parameters of ``parameter_source``. ``idle_power`` in W was measured at rest. ``early_end``
    says why there are fewer cycles than were asked for, ``missing`` why a number is NaN; both are empty otherwise.
    """

    name: str
    run: Run
    played: PlayedGait
    averaged_cycles: tuple[int, int]
    content: ParameterFile
    parameter_source: str
    replay: Replay
    judged: ReplayReport
    measured: Bands
    twin: Bands
    expected: Expectation
    idle_power: float
    events: tuple[Event, ...]
    early_end: str
    missing: tuple[str, ...]
    provenance: dict[str, str]

    @property
    def gait(self) -> Gait:
        """The gait that was played."""
        return self.played.gait

    @property
    def window(self) -> Window:
        """The span of the averaged cycles."""
        return self.played.cycle_window(*self.averaged_cycles)


def recorded_gait(
    run: Run,
    name: str,
    replay: Replay,
    parameters: tuple[ParameterFile, str],
    events: tuple[Event, ...],
    provenance: dict[str, str],
) -> RecordedGait:
    """Judges one gait by its part of a recording and of the twin's replay, and predicts it.

    ``parameters`` are the file's content and where it comes from. Raises `RecordingError` if the part holds no gait.
    """
    content, source = parameters
    try:
        played = last_played_gait(run.gait_state)
    except RecordingError as error:
        raise RecordingError(f"{name}: {error}") from None
    averaged = averaged_cycles(run, played)
    window = played.cycle_window(*averaged)
    spans = [window, *single_cycles(window, averaged[1] - averaged[0] + 1)]
    missing: list[str] = []
    mass, direction = content.parameters.mass, played.gait.direction
    states = replay.states
    followed = (states["stamp_ns"], states["rear_position"])
    energy = accumulated_energy((run.power.stamp, run.power.valid_power))
    tracked = (run.tracker.stamp, run.tracker.rear_position)
    return RecordedGait(
        name=name,
        run=run,
        played=played,
        averaged_cycles=averaged,
        content=content,
        parameter_source=source,
        replay=replay,
        judged=report_replay(run, replay, content.parameters.pitch),
        measured=_bands(tracked, energy, spans, direction, mass, missing),
        twin=_bands(followed, (states["stamp_ns"], states["energy"]), spans, direction, mass, []),
        expected=expect(played.gait, content, averaged),
        idle_power=idle_power(run, played),
        events=events,
        early_end=_early_end(run, played, events),
        missing=tuple(missing),
        provenance=provenance,
    )


def _early_end(run: Run, played: PlayedGait, events: Sequence[Event]) -> str:
    """`early_end`, with what the driver said of it."""
    reason = early_end(run, played)
    said = [event.text for event in events if event.source == "driver" and event.level == "error"]
    return f"{reason} ({said[0]})" if reason and said else reason


def _bands(
    position: Samples,
    energy: Samples,
    spans: Sequence[Window],
    direction: int,
    mass: float,
    missing: list[str],
) -> Bands:
    """Means over the first span, their bounds those of the other ones."""
    speeds = [direction * rate for rate in _rates(position, spans, "position of x1", missing)]
    powers = list(_rates(energy, spans, "power", missing))
    costs = [float(cost_of_transport(v, p, mass)) for v, p in zip(speeds, powers, strict=True)]
    if math.isnan(speeds[0]) or math.isnan(powers[0]):
        costs = [math.nan] * len(spans)
    return Bands(*(_band(values) for values in (speeds, powers, costs)))


def _band(values: list[float]) -> Band:
    mean, *single = values
    return Band(mean, min(single), max(single))


def _rates(
    samples: Samples, spans: Sequence[Window], name: str, missing: list[str]
) -> Iterator[float]:
    """Mean rate over each span; NaN where the samples do not reach, which ``missing`` then says once."""
    for span in spans:
        try:
            yield mean_rate(samples, span, name)
        except RecordingError as error:
            if str(error) not in missing:
                missing.append(str(error))
            yield math.nan
