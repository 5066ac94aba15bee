# SPDX-License-Identifier: Apache-2.0
"""Metrics of a run: averaged cycles, mean rates such as speed and power, energy, idle power, root mean square.

The protocol is the paper's: the last three of the played whole cycles are averaged. The driver does not depend on this
package and computes its own metrics for the result of RunGait. A test compares these with the metrics of this module.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from worm_model.arrays import Array, Stamps, accumulated
from worm_model.errors import RecordingError
from worm_model.gait import AVERAGED, Gait, GaitError
from worm_model.margin.measured_margin import RunMargin, measure_cycles
from worm_model.parameters import Parameters
from worm_model.run import PLAYING, Activity, GaitStates, Run, state_name

Samples = tuple[Stamps, Array]  # stamps in ns since the epoch and values, NaN if missing

AVERAGED_CYCLES = AVERAGED
IDLE_SAMPLES = 10  # valid samples at rest whose mean is the idle power (eq:Pidle_est)
# ns, tolerance between the stamp of a gait's end and its onset plus whole cycles. The driver converts both from its
# monotonic clock to system time, at different moments.
END_TOLERANCE_NS = 100_000_000
_FOREVER = int(np.iinfo(np.int64).max)


@dataclass(frozen=True)
class Window:
    """Span of whole cycles, from the point of rest before them to the point of rest after them, ns since the epoch."""

    start: int
    end: int

    @property
    def duration(self) -> float:
        """Duration in s."""
        return (self.end - self.start) / 1e9


@dataclass(frozen=True)
class PlayedGait:
    """Gait that was played. Stamps are in ns since the epoch.

    Attributes:
        gait: the gait.
        onset: stamp at which the first cycle began.
        cycles: requested number of cycles.
        end: stamp at which the driver reported the end of the gait or, if the recording ends earlier, STOPPING; None
            if it reported neither.
        state_after: state at ``end``, a value of GaitState.state. It is STOPPING for a gait that was stopped, unless it
            ended in FAULT. None if ``end`` is None.
        rest_start: stamp of the last message with the state RESTING before the onset; None if there is none.
        run: the driver's number of the run; 0 in recordings without run numbers.
    """

    gait: Gait
    onset: int
    cycles: int
    end: int | None = None
    state_after: int | None = None
    rest_start: int | None = None
    run: int = 0

    def cycle_window(self, first: int, last: int) -> Window:
        """Return the span of the cycles ``first`` to ``last``, counted from 1."""
        period = 1e9 * self.gait.period
        return Window(self.onset + round((first - 1) * period), self.onset + round(last * period))

    def whole_cycles_until(self, stamp: int) -> int:
        """Return the number of the requested cycles that had been played completely at a stamp (ns)."""
        played_until = stamp if self.end is None else min(stamp, self.end + END_TOLERANCE_NS)
        cycles = math.floor((played_until - self.onset) / (1e9 * self.gait.period))
        return max(min(cycles, self.cycles), 0)


def last_played_gait(states: GaitStates) -> PlayedGait:
    """Return the last gait that was played; raise `RecordingError` if there is none, or if the gait is inadmissible."""
    runs = states.rows_of_runs()
    if not runs:
        raise RecordingError(
            "the recording contains no run of a gait: record one, with the topic gait_state"
        )
    return _played_gait(states, runs[-1])


def played_gaits(states: GaitStates) -> list[PlayedGait]:
    """Return the gaits that were played, in order; inadmissible gaits are omitted."""
    gaits = []
    for rows in states.rows_of_runs():
        with suppress(RecordingError):
            gaits.append(_played_gait(states, rows))
    return gaits


def _played_gait(states: GaitStates, rows: NDArray[np.int64]) -> PlayedGait:
    row = int(rows[-1])
    try:
        gait = states.gait(row)
    except GaitError as error:
        raise RecordingError(
            f"the recording contains a gait that is not admissible: {error}"
        ) from None
    later = states.stamp > states.stamp[row]
    stopping = np.flatnonzero(later & (states.state == Activity.STOPPING))
    over = np.flatnonzero(later & ~np.isin(states.state, PLAYING))
    ends = over if over.size else stopping
    after = int(ends[np.argmin(states.stamp[ends])]) if ends.size else None
    onset = int(states.onset[row])
    rests = states.stamp[(states.state == Activity.RESTING) & (states.stamp <= onset)]
    return PlayedGait(
        gait=gait,
        onset=onset,
        cycles=int(states.cycles[row]),
        end=None if after is None else int(states.stamp[after]),
        state_after=None if after is None else _state_after(states, after, stopping),
        rest_start=int(rests[-1]) if rests.size else None,
        run=int(states.run[row]),
    )


def _state_after(states: GaitStates, after: int, stopping: NDArray[np.int64]) -> int:
    """Return the driver's state in row ``after``; STOPPING if the gait was stopped and did not end in FAULT."""
    state = int(states.state[after])
    stopped = np.any(states.stamp[stopping] <= states.stamp[after])
    return Activity.STOPPING if stopped and state != Activity.FAULT else state


def measure_margin(run: Run, parameters: Parameters, grooves: int | None = None) -> RunMargin:
    """Return the measured margins of the last gait of a recording, see `measure_cycles`."""
    played = last_played_gait(run.gait_state)
    cycles = played.whole_cycles_until(int(run.tracker.stamp.max(initial=played.onset)))
    return measure_cycles(run, played.gait, played.onset, cycles, parameters, grooves)


def completed_cycles(run: Run, played: PlayedGait) -> int:
    """Return the number of whole cycles before the end of the gait and the last valid sample of each instrument.

    The instruments are tracker and power sensor. One without valid samples is ignored.
    """
    stamps = (
        run.tracker.stamp[np.isfinite(run.tracker.rear_position)],
        run.power.stamp[np.isfinite(run.power.valid_power)],
    )
    ends = [int(stamp[-1]) for stamp in stamps if stamp.size]
    return played.whole_cycles_until(min(ends, default=_FOREVER))


def averaged_cycles(run: Run, played: PlayedGait) -> tuple[int, int]:
    """Return the numbers (from 1) of the first and the last averaged cycle.

    The averaged cycles are the last three that were completely played and recorded. Without such a cycle
    (`completed_cycles` is 0), the result is (1, 1), and the caller must treat speed and power as unavailable.
    """
    last = max(completed_cycles(run, played), 1)
    return max(last - AVERAGED_CYCLES, 0) + 1, last


def early_end(run: Run, played: PlayedGait) -> str:
    """Return a remark on a gait that ended early or in FAULT, or was not recorded completely; otherwise empty."""
    if played.state_after is not None and played.end is not None:
        done = played.whole_cycles_until(_FOREVER)
        if played.state_after == Activity.FAULT:
            return f"ended in FAULT after {done} of {played.cycles} cycles"
        if done < played.cycles:
            stopped = played.state_after == Activity.STOPPING
            how = "stopped" if stopped else f"ended ({state_name(played.state_after)})"
            return f"{how} after {done} of {played.cycles} cycles"
    recorded = completed_cycles(run, played)
    if recorded < played.cycles:
        return f"only {recorded} of {played.cycles} cycles were recorded completely"
    return ""


def mean_rate(samples: Samples, window: Window, name: str) -> float:
    """Return the mean rate of change of the samples over a window, per s.

    Raises `RecordingError` with the ``name`` of the quantity if the samples do not cover the window.
    """
    stamps, values = _known(samples)
    if stamps.size == 0 or stamps[0] > window.start or stamps[-1] < window.end:
        raise RecordingError(f"the recording has no {name} over the averaged cycles")
    seconds = (stamps - window.start) * 1e-9
    first, last = np.interp([0.0, window.duration], seconds, values)
    return float(last - first) / window.duration


def accumulated_energy(power: Samples) -> Samples:
    """Return the energy (J) since the first valid sample of a power (W), at each valid sample (trapezoidal rule)."""
    stamps, values = _known(power)
    return stamps, accumulated((stamps - stamps[:1]).astype(np.float64) * 1e-9, values)


def idle_power(run: Run, played: PlayedGait) -> float:
    """Return the mean power (W) of the first ten valid samples in the rest before a gait (eq:Pidle_est).

    The result is NaN with fewer samples.
    """
    if played.rest_start is None:
        return math.nan
    power = run.power
    at_rest = np.isfinite(power.valid_power) & (power.stamp >= played.rest_start)
    at_rest &= power.stamp < played.onset
    values = power.power[at_rest][:IDLE_SAMPLES]
    return float(values.mean()) if values.size == IDLE_SAMPLES else math.nan


def single_cycles(window: Window, cycles: int) -> Iterator[Window]:
    """Divide a window of ``cycles`` whole cycles into one window for each cycle."""
    borders = np.linspace(window.start, window.end, cycles + 1).round().astype(np.int64).tolist()
    for start, end in pairwise(borders):
        yield Window(start, end)


def root_mean_square(values: Array) -> float:
    """Return the root mean square of the finite values; NaN without any."""
    finite = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(finite**2))) if finite.size else math.nan


def _known(samples: Samples) -> Samples:
    stamps, values = samples
    known = np.isfinite(values)
    return stamps[known], values[known]
