# SPDX-License-Identifier: Apache-2.0
"""Compares what an instrument says with the twin, and keeps the residuals' sizes and the health they speak of.

Each channel (position, length, power) keeps the mean square of its residual in units of its usual size, forgotten
over ``MEMORY_S``. The root of it decides: suspect beyond ``SUSPECT_FROM``, faulty beyond ``FAULTY_FROM``. It has to
stay below ``RECOVERY`` of that for a whole cycle to be better: what comes and goes with the gait does not flicker.
A channel without samples for ``SILENT_S`` has no say.
"""

from __future__ import annotations

import math

from worm_model.simulation.kernel.compiled import entry
from worm_model.simulation.kernel.march import X1
from worm_model.simulation.kernel.mode import Constants
from worm_model.twin.core.intake import LENGTH as LENGTH_SAMPLE
from worm_model.twin.core.intake import POSITION as POSITION_SAMPLE
from worm_model.twin.core.memory import (
    CHANNELS,
    LENGTH,
    LENGTH_SUM,
    NANOSECONDS,
    PHASES,
    POSITION,
    POSITION_SUM,
    POWER,
    POWER_SUM,
    Memory,
    Rows,
    Rules,
)

MEMORY_S = 2.0
SILENT_S = 5.0
SUSPECT_FROM = 2.0
FAULTY_FROM = 4.0
RECOVERY = 0.75
NOISE_SAMPLES = 500  # over which noise is averaged
TOP_SPEED = 0.15  # m/s; no gait of the paper's box is faster
UNKNOWN, HEALTHY, SUSPECT, FAULTY = range(4)  # as in `worm_model.twin.records.Health`


@entry
def observe(memory: Memory, channel: int, stamp: int, residual: float, scale: float) -> None:
    """A residual of a channel, and its usual size, to which its noise adds."""
    m = memory.record[0]
    square = residual**2 / (scale**2 + m.noise_square[channel])
    before = m.channel_ns[channel]
    if before > 0:
        share = math.exp(-max(stamp - before, 0) * 1e-9 / MEMORY_S)
        square = share * m.channel_square[channel] + (1.0 - share) * square
    else:
        square = min(square, 1.0)  # one sample is no history
    m.channel_ns[channel], m.channel_square[channel] = max(stamp, before), square


@entry
def _listen(memory: Memory, channel: int, residual: float) -> None:
    """Follows the noise of a channel: second differences of its residuals, in which what lasts vanishes."""
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
    """Root of a channel's mean square in usual sizes; NaN if it has no say."""
    m = memory.record[0]
    heard = m.channel_ns[channel]
    if heard == 0 or stamp - heard > SILENT_S * NANOSECONDS:
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
def _hold(memory: Memory, channel: int, stamp: int, level: int) -> int:
    """The level that a channel keeps: a better one only after a whole cycle."""
    m = memory.record[0]
    before = m.channel_level[channel]
    if level >= before or level == UNKNOWN:
        m.level_ns[channel] = stamp
        return level
    cycle = 1.0 / m.frequency if m.frequency > 0.0 else MEMORY_S
    return level if (stamp - m.level_ns[channel]) * 1e-9 > cycle else before


@entry
def health_at(memory: Memory, stamp: int) -> int:
    """The health at a stamp, from the channels' levels and what was warned of."""
    m = memory.record[0]
    health = SUSPECT if m.warning > 0 and stamp <= m.warned_until else UNKNOWN
    for channel in range(CHANNELS):
        level = _level(m.channel_level[channel], size_of(memory, channel, stamp))
        m.channel_level[channel] = level = _hold(memory, channel, stamp, level)
        health = max(health, level)
    return health


@entry
def _record(
    memory: Memory,
    stamp: int,
    channel: int,
    residual: float,
    energy: float,
    rules: Rules,
    out: Rows,
) -> None:
    m, row = memory.record[0], out.residuals[out.counts[1]]
    row.stamp_ns = stamp
    row.rear_position = residual if channel == POSITION else math.nan
    row.length = residual if channel == LENGTH else math.nan
    row.power = residual if channel == POWER else math.nan
    row.rear_position_scale = rules.position_scale
    row.length_scale, row.power_scale = rules.length_scale, rules.power_scale
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
    """Adds a residual to the running cycle, if there is one, and to what is known of the noise."""
    m = memory.record[0]
    if not m.cycle_end_ns or stamp < m.start_ns:
        return
    phase = (stamp - m.start_ns) * 1e-9 * m.frequency - (m.cycle - 1)
    k = min(max(int(phase * PHASES), 0), PHASES - 1)
    _listen(memory, column // 2, residual)
    memory.sums[k, column] += residual
    memory.sums[k, column + 1] += 1.0


@entry
def _look(memory: Memory, stamp: int, position: float, rules: Rules) -> bool:
    """Whether the tracker's position is a possible one: it cannot jump."""
    m = memory.record[0]
    elapsed = max(stamp - m.sight_ns, 0) * 1e-9
    # The negation lets the first pass, whose jump is NaN.
    if not abs(position - m.sight) > rules.gate + TOP_SPEED * elapsed:
        m.sight_ns, m.sight, m.refused_ns, m.refused = stamp, position, 0, math.nan
        return True
    if not abs(position - m.refused) <= rules.gate:
        m.refused_ns, m.refused = stamp, position
    return False


@entry
def _judge_position(
    memory: Memory, stamp: int, position: float, rules: Rules, c: Constants, out: Rows
) -> bool:
    """Whether the tracker was moved."""
    m = memory.record[0]
    expected = memory.sample[0, X1] + m.moved * c.pitch
    accepted = _look(memory, stamp, position, rules)
    if not m.origin_known:  # nothing else has told where the robot stands
        m.origin, m.origin_known = position - expected, 1
    residual = position - expected - m.origin
    if accepted:
        if m.start_known:
            observe(memory, POSITION, stamp, residual, rules.position_scale)
        _sum_up(memory, stamp, POSITION_SUM, residual)
        _record(memory, stamp, POSITION, residual, math.nan, rules, out)
    elif stamp - m.refused_ns >= rules.moved:
        # Refused positions that stay: the tracker (or the robot, by hand) was moved, the twin's zero follows.
        m.origin += residual
        m.sight_ns, m.sight, m.refused_ns, m.refused = stamp, position, 0, math.nan
        m.event_value = residual
        return True
    return False


@entry
def _judge_power(memory: Memory, stamp: int, power: float, rules: Rules, out: Rows) -> None:
    m = memory.record[0]
    residual = power - m.power
    if stamp > m.instrument_ns:
        before = power if math.isnan(m.instrument_power) else m.instrument_power
        m.instrument_energy += 0.5 * (before + power) * (stamp - m.instrument_ns) * 1e-9
        m.instrument_ns, m.instrument_power = stamp, power
    # No window resolves the step of the length rate at the onset.
    if (stamp - m.start_ns) * 1e-9 > 4.0 * rules.smoothing:
        # What the noise of the length makes of the prediction is smooth, and no noise of the residual.
        scale = math.sqrt(rules.power_scale**2 + m.power_variance)
        if m.start_known:
            observe(memory, POWER, stamp, residual, scale)
        _sum_up(memory, stamp, POWER_SUM, residual)
    _record(memory, stamp, POWER, residual, m.instrument_energy - m.energy, rules, out)


@entry
def _settled(memory: Memory, rules: Rules) -> bool:
    """Whether the lengths are known that the predicted power rests on; at the end of a recording some never will be."""
    m = memory.record[0]
    window = round(rules.smoothing * NANOSECONDS)
    return bool(m.on_estimate) or m.present >= memory.rows[m.place].stamp + window


@entry
def judge(memory: Memory, rules: Rules, c: Constants, out: Rows) -> bool:
    """Compares the sample that is being taken, as far as answer and motion came to it; True if the tracker moved."""
    m = memory.record[0]
    row = memory.rows[m.place]
    if row.kind == LENGTH_SAMPLE and m.answered and m.start_ns and not m.end_ns:
        # After a run the slack of a resting cable comes back, the actuation model does not say when; before the first
        # one a stop may hold the cable anywhere.
        residual = row.a - m.initial_length - m.answer
        observe(memory, LENGTH, row.stamp, residual, rules.length_scale)
        _sum_up(memory, row.stamp, LENGTH_SUM, residual)
        _record(memory, row.stamp, LENGTH, residual, math.nan, rules, out)
    elif row.kind == POSITION_SAMPLE and m.arrived and not math.isnan(row.a):
        return _judge_position(memory, row.stamp, row.a, rules, c, out)
    elif row.kind > POSITION_SAMPLE and m.arrived and _settled(memory, rules):
        _judge_power(memory, row.stamp, row.a, rules, out)
    return False
