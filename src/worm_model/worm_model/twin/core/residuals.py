# SPDX-License-Identifier: Apache-2.0
"""Comparison of the measurements with the twin: residuals, their sizes and the health.

For each channel (position, length, power), the residuals are divided by their usual size, squared and averaged over
``MEMORY_S``. The root of this average determines the level of the channel: suspect above ``SUSPECT_FROM``, faulty above
``FAULTY_FROM``. A level improves only after the root has been at most ``RECOVERY`` times the limit for a whole cycle.
Otherwise the level could alternate within each cycle. A channel without samples for ``SILENT_S`` is ignored.
"""

from __future__ import annotations

import math

from worm_model.run import Activity
from worm_model.simulation.kernel.compiled import entry
from worm_model.simulation.kernel.march import X1
from worm_model.simulation.kernel.mode import Constants
from worm_model.twin.core.memory import (
    CHANNELS,
    LENGTH,
    LENGTH_KIND,
    LENGTH_SUM,
    NANOSECONDS,
    PHASES,
    POSITION,
    POSITION_KIND,
    POSITION_SUM,
    POWER,
    POWER_SUM,
    SMOOTHING_NS,
    SMOOTHING_S,
    Memory,
    OutputRows,
)
from worm_model.twin.data.records import Health

MEMORY_S = 2.0  # s, time constant of the average
SILENT_S = 5.0  # s; a channel whose last residual is older than this does not affect the health
SUSPECT_FROM = 2.0  # limits of the root mean square, in usual sizes
FAULTY_FROM = 4.0
RECOVERY = 0.75  # share of a limit at which the level of a channel improves
NOISE_SAMPLES = 500  # number of residuals over which the noise of a channel is averaged
TOP_SPEED = 0.15  # m/s, above the speed of all gaits of the paper's box
# A position that jumps by more than this plus TOP_SPEED times the elapsed time is rejected. If rejected positions agree
# with each other for MOVED_NS, the tracker was moved.
GATE_M, MOVED_NS = 0.05, 500_000_000
RESTING = int(Activity.RESTING)
UNKNOWN, HEALTHY, SUSPECT, FAULTY = (int(health) for health in Health)


@entry
def observe(memory: Memory, channel: int, stamp: int, residual: float, scale: float) -> None:
    """Add a residual to the mean square of its channel.

    ``scale`` is the usual size. The square of the residual is divided by scale² plus the estimated variance of the
    noise. ``residual`` and ``scale`` are in m or W.
    """
    m = memory.record[0]
    square = residual**2 / (scale**2 + m.noise_square[channel])
    before = m.channel_ns[channel]
    if before > 0:
        share = math.exp(-max(stamp - before, 0) * 1e-9 / MEMORY_S)
        square = share * m.channel_square[channel] + (1.0 - share) * square
    else:
        square = min(square, 1.0)  # a single sample must not make the robot suspect
    m.channel_ns[channel], m.channel_square[channel] = max(stamp, before), square


@entry
def _track_noise(memory: Memory, channel: int, residual: float) -> None:
    """Update the noise of a channel from second differences of its residuals, which cancel slow changes."""
    m = memory.record[0]
    last, before = m.noise_last[channel], m.noise_before[channel]
    count = m.noise_count[channel]
    if count >= 2:
        share = 1.0 / min(count - 1, NOISE_SAMPLES)
        square = (residual - 2.0 * last + before) ** 2 / 6.0
        m.noise_square[channel] += share * (square - m.noise_square[channel])
    m.noise_before[channel], m.noise_last[channel] = last, residual
    m.noise_count[channel] = count + 1


@entry
def size_of(memory: Memory, channel: int, stamp: int) -> float:
    """Return the root mean square of a channel, relative to the usual size; NaN if the channel is silent."""
    m = memory.record[0]
    last = m.channel_ns[channel]
    if last == 0 or stamp - last > SILENT_S * NANOSECONDS:
        return math.nan
    return math.sqrt(m.channel_square[channel])


@entry
def _level(before: int, size: float) -> int:
    if math.isnan(size):
        return UNKNOWN
    if size > FAULTY_FROM or (before == FAULTY and size > RECOVERY * FAULTY_FROM):
        return FAULTY
    if size > SUSPECT_FROM or (before >= SUSPECT and size > RECOVERY * SUSPECT_FROM):
        return SUSPECT
    return HEALTHY


@entry
def _delayed(memory: Memory, channel: int, stamp: int, level: int) -> int:
    """Return the level of a channel, which improves only if the better ``level`` has lasted for a whole cycle."""
    m = memory.record[0]
    before = m.channel_level[channel]
    if level >= before or level == UNKNOWN:
        m.level_ns[channel] = stamp
        return level
    cycle = 1.0 / m.frequency if m.frequency > 0.0 else MEMORY_S
    return level if (stamp - m.level_ns[channel]) * 1e-9 > cycle else before


@entry
def health_at(memory: Memory, stamp: int) -> int:
    """Update the levels of the channels at a stamp; return the health from these levels and the last warning."""
    m = memory.record[0]
    health = SUSPECT if m.warning > 0 and stamp <= m.warned_until else UNKNOWN
    for channel in range(CHANNELS):
        level = _level(m.channel_level[channel], size_of(memory, channel, stamp))
        m.channel_level[channel] = level = _delayed(memory, channel, stamp, level)
        health = max(health, level)
    return health


@entry
def _record(
    memory: Memory,
    stamp: int,
    channel: int,
    residual: float,
    energy: float,
    out: OutputRows,
) -> None:
    m, row = memory.record[0], out.residuals[out.counts[1]]
    row.stamp_ns = stamp
    row.rear_position = residual if channel == POSITION else math.nan
    row.length = residual if channel == LENGTH else math.nan
    row.power = residual if channel == POWER else math.nan
    row.rear_position_scale = m.usual_size[POSITION]
    row.length_scale, row.power_scale = m.usual_size[LENGTH], m.usual_size[POWER]
    row.energy = energy
    row.health = health_at(memory, stamp)
    row.position_size = size_of(memory, POSITION, stamp)
    row.length_size = size_of(memory, LENGTH, stamp)
    row.power_size = size_of(memory, POWER, stamp)
    row.position_level = m.channel_level[POSITION]
    row.length_level = m.channel_level[LENGTH]
    row.power_level = m.channel_level[POWER]
    row.warning = m.warning if stamp <= m.warned_until else 0
    out.counts[1] += 1


@entry
def _sum_up(memory: Memory, stamp: int, column: int, residual: float) -> None:
    """Add a residual to the sums of the cycle and to the estimate of the noise, if a cycle is running."""
    m = memory.record[0]
    if not m.cycle_end_ns or stamp < m.start_ns:
        return
    phase = (stamp - m.start_ns) * 1e-9 * m.frequency - (m.cycle - 1)
    k = min(max(int(phase * PHASES), 0), PHASES - 1)
    _track_noise(memory, column // 2, residual)
    memory.sums[k, column] += residual
    memory.sums[k, column + 1] += 1.0


@entry
def _is_plausible(memory: Memory, stamp: int, position: float) -> bool:
    """Return True if a position is reachable from the last accepted one.

    The position is stored as accepted, or as rejected if it begins a jump.
    """
    m = memory.record[0]
    elapsed = max(stamp - m.accepted_ns, 0) * 1e-9
    # The negation accepts the first position, whose jump is NaN.
    if not abs(position - m.accepted) > GATE_M + TOP_SPEED * elapsed:
        m.accepted_ns, m.accepted, m.rejected_ns, m.rejected = stamp, position, 0, math.nan
        return True
    if not abs(position - m.rejected) <= GATE_M:
        m.rejected_ns, m.rejected = stamp, position
    return False


@entry
def _judge_position(
    memory: Memory, stamp: int, position: float, c: Constants, out: OutputRows
) -> float:
    """Compare a position with the twin; return the shift (m) of a tracker that was moved, otherwise 0."""
    m = memory.record[0]
    expected = memory.sample[0, X1] + m.moved * c.body.pitch
    accepted = _is_plausible(memory, stamp, position)
    if not m.origin_known:  # the first position defines the origin
        m.origin, m.origin_known = position - expected, 1
    residual = position - expected - m.origin
    if accepted:
        # The model does not describe the motion while the fins are turned before a gait. On a slope, the robot can then
        # move by up to a groove.
        if m.start_known and m.activity != RESTING:
            counted = max(abs(residual) - m.edge_slack, 0.0)
            observe(memory, POSITION, stamp, counted, m.usual_size[POSITION])
        _sum_up(memory, stamp, POSITION_SUM, residual)
        _record(memory, stamp, POSITION, residual, math.nan, out)
    elif stamp - m.rejected_ns >= MOVED_NS:
        # The rejected positions agree for long enough: the tracker or the robot was moved. The origin follows.
        m.origin += residual
        m.accepted_ns, m.accepted, m.rejected_ns, m.rejected = stamp, position, 0, math.nan
        return residual
    return 0.0


@entry
def _judge_power(memory: Memory, stamp: int, power: float, out: OutputRows) -> None:
    m = memory.record[0]
    residual = power - m.power
    if stamp > m.instrument_ns:
        before = power if math.isnan(m.instrument_power) else m.instrument_power
        m.instrument_energy += 0.5 * (before + power) * (stamp - m.instrument_ns) * 1e-9
        m.instrument_ns, m.instrument_power = stamp, power
    # At the onset the rate of the length jumps. The smoothed rate, and so the predicted power, is wrong near this jump.
    if (stamp - m.start_ns) * 1e-9 > 4.0 * SMOOTHING_S:
        # Noise of the lengths makes the predicted power vary slowly. The estimate of the noise ignores slow changes.
        # Therefore this variance is added here.
        scale = math.sqrt(m.usual_size[POWER] ** 2 + m.power_variance)
        if m.start_known:
            observe(memory, POWER, stamp, residual, scale)
        _sum_up(memory, stamp, POWER_SUM, residual)
    _record(memory, stamp, POWER, residual, m.instrument_energy - m.energy, out)


@entry
def _is_settled(memory: Memory) -> bool:
    """Return True if all lengths from which the power is predicted have arrived."""
    m = memory.record[0]
    return bool(m.on_estimate) or m.present >= memory.rows[m.place].stamp + SMOOTHING_NS


@entry
def judge(memory: Memory, c: Constants, out: OutputRows) -> float:
    """Compare the row being processed with the twin.

    A length is compared only during a run, if ΔL from the actuation model (`Memory`: answer) is known at this row. A
    position or a power is compared only if the motion is computed up to this row. For a power, all lengths from which
    it is predicted must have arrived, too.

    Returns the shift (m) of a tracker that was moved, otherwise 0.
    """
    m = memory.record[0]
    row = memory.rows[m.place]
    if row.kind == LENGTH_KIND and m.answered and m.start_ns and not m.end_ns:
        # Lengths are compared only during a run. After it the slack of the resting cable returns, at a time that the
        # actuation model does not describe. Before the first run the driver may hold the cable at any length.
        residual = row.a - m.initial_length - m.answer
        observe(memory, LENGTH, row.stamp, residual, m.usual_size[LENGTH])
        _sum_up(memory, row.stamp, LENGTH_SUM, residual)
        _record(memory, row.stamp, LENGTH, residual, math.nan, out)
    elif row.kind == POSITION_KIND and m.arrived and not math.isnan(row.a):
        return _judge_position(memory, row.stamp, row.a, c, out)
    elif row.kind > POSITION_KIND and m.arrived and _is_settled(memory):
        _judge_power(memory, row.stamp, row.a, out)
    return 0.0
