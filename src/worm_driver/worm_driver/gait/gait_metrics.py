# SPDX-License-Identifier: Apache-2.0
"""Metrics of a run by the paper's protocol.

Speed and power are means over the last three complete cycles (over all, if there are fewer). The idle power is the mean
of the first ten valid samples at rest. Times are monotonic, in s. Metrics that cannot be computed are NaN. Missing
speed, power and idle power have a reason. Speed and power are also NaN if a gap in their data is too long to bridge,
and power if a sample overflowed: data are seldom missing at random, and a sensor overflows where the power is largest.
"""

import math
from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from worm_driver.gait.gait_player import PlayedRun
from worm_driver.power.ina219 import PowerSample, SampleStatus, reversed_current
from worm_msgs.robot_parameters import STANDARD_GRAVITY, RobotParameters

AVERAGED_CYCLES = 3
IDLE_SAMPLES = 10

#: s, longest gap between two tracker samples for linear interpolation (two lost samples at 30 Hz)
_TRACKER_GAP = 0.12
#: s, longest gap between two tracker samples that is bridged by a cubic, see `RunRecord.position_at`
_LONGEST_BRIDGE = 0.5
#: s, duration of the span before a gap, and of the span after it, to whose samples the cubic is fitted
_BRIDGE_SIDE = 0.25
#: smallest number of samples in each of the two spans
_LEAST_SAMPLES = 4
#: s, longest time without a valid power sample within the averaged cycles
_POWER_GAP = 0.25


@dataclass
class RunRecord:
    """Measurements of a run.

    Attributes:
        positions: tracker samples (time in s, x1 in m) in order of time; occluded samples are omitted.
        power: all samples of the power sensor in order of time.
    """

    positions: list[tuple[float, float]] = field(default_factory=list)
    power: list[PowerSample] = field(default_factory=list)

    def position_at(self, time: float) -> tuple[float, float]:
        """Return x1 (m) at a time (s), and the duration (s) of the tracker's gap that contains this time.

        x1 is interpolated linearly between neighbouring samples at most 0.12 s apart; the duration is then 0. A longer
        gap of at most 0.5 s is bridged by a cubic, because x1 is curved at the start of a cycle. The cubic is fitted to
        the samples of 0.25 s on either side of the gap. x1 is NaN in a gap of more than 0.5 s, and in a gap with fewer
        than 4 such samples on a side. Before the first sample and after the last one, x1 is NaN and the duration is
        infinite.
        """
        after = bisect_left(self.positions, (time, -math.inf))
        if after == len(self.positions):
            return math.nan, math.inf
        t1, x1 = self.positions[after]
        if t1 == time:
            return x1, 0.0
        if after == 0:
            return math.nan, math.inf
        t0, x0 = self.positions[after - 1]
        if t1 - t0 <= _TRACKER_GAP:
            return x0 + (x1 - x0) * (time - t0) / (t1 - t0), 0.0
        return self._bridged(time, t0, t1), t1 - t0

    def _bridged(self, time: float, last: float, first: float) -> float:
        sides = (
            [(t, x) for t, x in self.positions if last - _BRIDGE_SIDE <= t <= last],
            [(t, x) for t, x in self.positions if first <= t <= first + _BRIDGE_SIDE],
        )
        if first - last > _LONGEST_BRIDGE or min(map(len, sides)) < _LEAST_SAMPLES:
            return math.nan
        times, positions = zip(*(sides[0] + sides[1]), strict=True)
        return float(np.polyfit(np.subtract(times, time), positions, 3)[-1])

    def latest_power(self) -> float:
        """Return the power of the latest valid sample, W; NaN without one."""
        for sample in reversed(self.power):
            if sample.status is SampleStatus.VALID:
                return sample.power
        return math.nan


@dataclass(frozen=True)
class RunMetrics:
    """Measured metrics of a run, SI. A metric that cannot be computed is NaN.

    Attributes:
        cycles_completed: number of complete cycles.
        cycles_averaged: number of cycles over which speed and power are averaged, the last complete ones.
        distance: displacement of x1 along the gait's direction over all complete cycles, m.
        speed: mean speed of x1 along the gait's direction, m/s.
        power: mean source power, W.
        cost_of_transport: power divided by the product of weight and absolute speed, without unit.
        idle_power: mean source power at rest before the onset, W.
        reasons: why metrics are missing or less certain, at most one sentence for each. There is none for the distance,
            nor for a cost of transport that is missing because power or speed is missing.
    """

    cycles_completed: int
    cycles_averaged: int
    distance: float
    speed: float
    power: float
    cost_of_transport: float
    idle_power: float
    reasons: tuple[str, ...]


def run_metrics(run: PlayedRun, record: RunRecord, body: RobotParameters) -> RunMetrics:
    """Return the metrics of a run that has ended."""
    assert run.end is not None
    completed = run.cycles_completed(run.end)
    averaged = min(AVERAGED_CYCLES, completed)
    rest = _rest_samples(run, record.power)
    idle_power, idle_reason = _idle_power(run, rest)
    wrong_sign = "" if idle_reason else reversed_current(rest)
    if wrong_sign:
        idle_power, idle_reason = math.nan, f"no power: {wrong_sign}"
    if run.onset is None or averaged == 0:
        reasons = _given("no cycle was completed", idle_reason)
        return RunMetrics(completed, 0, *(math.nan,) * 4, idle_power, reasons)
    end = run.onset + completed / run.gait.frequency
    start = end - averaged / run.gait.frequency
    speed, speed_reason = _speed(run, record, start, end)
    power, power_reason = _mean_power(record.power, start, end)
    if wrong_sign:
        power, power_reason = math.nan, ""
    cost, cost_reason = _cost_of_transport(power, speed, body)
    reasons = _given(speed_reason, power_reason, cost_reason, idle_reason)
    travelled = run.gait.direction * (record.position_at(end)[0] - record.position_at(run.onset)[0])
    return RunMetrics(completed, averaged, travelled, speed, power, cost, idle_power, reasons)


def distance(run: PlayedRun, record: RunRecord) -> float:
    """Return the displacement of x1 along the gait's direction from the onset to the latest sample, m.

    It is NaN before the onset, without samples, or if x1 at the onset is unknown.
    """
    if run.onset is None or not record.positions:
        return math.nan
    return run.gait.direction * (record.positions[-1][1] - record.position_at(run.onset)[0])


def _given(*reasons: str) -> tuple[str, ...]:
    return tuple(reason for reason in reasons if reason)


def _speed(run: PlayedRun, record: RunRecord, start: float, end: float) -> tuple[float, str]:
    if not record.positions:
        return math.nan, "no speed: no samples arrived on the topic tracker"
    (first, first_gap), (last, last_gap) = record.position_at(start), record.position_at(end)
    gap = max(first_gap, last_gap)
    if math.isinf(gap):
        return math.nan, _not_covered(record.positions, start, end)
    if math.isnan(last - first):
        where = f"the start or the end of the averaged cycles ({gap:.2f} s)"
        return math.nan, f"no speed: the tracker did not see the robot at {where}"
    note = (
        f"speed is less certain: x1 is interpolated over a gap of the tracker of {gap:.2f} s"
        if gap
        else ""
    )
    return run.gait.direction * (last - first) / (end - start), note


def _not_covered(positions: Sequence[tuple[float, float]], start: float, end: float) -> str:
    """Return why there is no speed if the tracker samples do not extend from a start to an end (s)."""
    causes = []
    if (late := positions[0][0] - start) > 0.0:
        causes.append(f"first saw the robot {late:.3f} s after the start of the averaged cycles")
    if (early := end - positions[-1][0]) > 0.0:
        causes.append(f"last saw the robot {early:.3f} s before the end of the averaged cycles")
    return f"no speed: the tracker {' and '.join(causes)}"


def _mean_power(samples: Sequence[PowerSample], start: float, end: float) -> tuple[float, str]:
    """Return the mean power (W) from a start to an end (s), and a reason if it is NaN.

    The mean is weighted with time: each valid sample counts until the next valid one, and the last one until the end.
    The first one also counts from the start to its own time. The mean is NaN if the time between two neighbouring valid
    samples, from the start to the first one, or from the last one to the end is too long.
    """
    window = [sample for sample in samples if start <= sample.time <= end]
    if not window:
        return math.nan, "no power: no samples of the power sensor arrived"
    overflows = sum(sample.status is SampleStatus.OVERFLOW for sample in window)
    if overflows:
        return math.nan, f"no power: {overflows} samples overflowed the sensor's range"
    valid = [sample for sample in window if sample.status is SampleStatus.VALID]
    times = [start, *(sample.time for sample in valid), end]
    gap = max(after - before for before, after in pairwise(times))
    if not valid or gap > _POWER_GAP:
        return math.nan, f"no power: no valid sample for {gap:.2f} s"
    borders = [start, *times[2:]]
    energy = math.fsum(
        sample.power * (after - before)
        for sample, (before, after) in zip(valid, pairwise(borders), strict=True)
    )
    return energy / (end - start), ""


def _cost_of_transport(power: float, speed: float, body: RobotParameters) -> tuple[float, str]:
    """Return COT = P / (m g |v|), and a reason if the speed is 0.

    If power or speed is NaN, return NaN and no further reason.
    """
    if math.isnan(power) or math.isnan(speed):
        return math.nan, ""
    if speed == 0.0:
        return math.nan, "no cost of transport: the speed is 0"
    return power / (body.mass * STANDARD_GRAVITY * abs(speed)), ""


def _rest_samples(run: PlayedRun, samples: Sequence[PowerSample]) -> list[PowerSample]:
    """Return the first ten valid samples at rest, or fewer."""
    if run.rest_start is None:
        return []
    end = math.inf if run.onset is None else run.onset
    return [
        sample
        for sample in samples
        if run.rest_start <= sample.time < end and sample.status is SampleStatus.VALID
    ][:IDLE_SAMPLES]


def _idle_power(run: PlayedRun, rest: Sequence[PowerSample]) -> tuple[float, str]:
    """Return the mean power (W) of the samples of `_rest_samples` (eq:Pidle_est), and a reason if it is NaN."""
    if run.rest_start is None:
        return math.nan, "no idle power: the rest did not begin"
    if len(rest) < IDLE_SAMPLES:
        reason = f"{len(rest)} valid samples at rest, {IDLE_SAMPLES} are needed"
        return math.nan, f"no idle power: {reason}"
    return math.fsum(sample.power for sample in rest) / IDLE_SAMPLES, ""
