# SPDX-License-Identifier: Apache-2.0
"""Parts of a cycle of a gait (`worm_model.gait.Gait`) over which the effective command has one form.

A cycle begins and ends with a part within the slack, if the pretension is below the slack. Between these parts, each
half of the cycle is a half wave of a cosine, or three pieces of the trapezoidal velocity profile. Two half waves of
equal duration form one sinusoid. In this module ``g`` is a gait as a row of GAIT_ROW (`worm_model.simulation.rows`).
"""

from __future__ import annotations

import math
from typing import Any

from worm_model.simulation.kernel.actuation_law import (
    Actuator,
    answer_to_line,
    answer_to_parabola,
    answer_to_sinusoid,
)
from worm_model.simulation.kernel.compiled import compiled, inlined
from worm_model.simulation.kernel.linear import Coefficients
from worm_msgs.gait import Profile

COSINE = float(Profile.COSINE)
PARTS = 8  # slack, three pieces of the contraction, three of the extension, slack

Borders = tuple[float, float, float, float, float, float, float, float]


@inlined
def _slack_time(share: float, g: Any, a: Actuator) -> float:
    """Return how long (s) the command is within the slack in a half that takes the fraction ``share`` of the cycle."""
    taken_up = (a.slack - g.pretension) / g.stroke
    if taken_up <= 0.0:
        return 0.0
    if taken_up >= 1.0:
        return share / g.frequency
    if g.profile == COSINE:
        return share * math.acos(1.0 - 2.0 * taken_up) / (math.pi * g.frequency)
    ramp, speed = g.ramp_share, 1.0 / (1.0 - g.ramp_share)
    if taken_up < 0.5 * speed * ramp:
        part = math.sqrt(2.0 * taken_up * ramp / speed)
    elif taken_up <= 1.0 - 0.5 * speed * ramp:
        part = taken_up / speed + 0.5 * ramp
    else:
        part = 1.0 - math.sqrt(2.0 * (1.0 - taken_up) * ramp / speed)
    return part * share / g.frequency


@compiled
def borders_of(begin: float, g: Any, a: Actuator) -> Borders:
    """Return the ends in s of the PARTS of a cycle that begins at ``begin`` in s; a part may have the duration 0."""
    period = 1.0 / g.frequency
    opening = begin + _slack_time(g.contraction_share, g, a)
    closing = begin + period - _slack_time(1.0 - g.contraction_share, g, a)
    middle, end = begin + g.contraction_share * period, begin + period
    if g.profile == COSINE:
        if g.contraction_share == 0.5:
            middle = closing
        return opening, middle, middle, middle, closing, closing, closing, end
    ramp = g.ramp_share * (middle - begin)
    first, second = max(opening, begin + ramp), max(opening, middle - ramp)
    ramp = g.ramp_share * (end - middle)
    third, fourth = min(closing, middle + ramp), min(closing, end - ramp)
    return opening, first, second, middle, third, fourth, closing, end


@inlined
def _answer_to_piece(
    piece: int, half: float, time: float, length_change: float, g: Any, a: Actuator
) -> Coefficients:
    """Return ΔL (m) as a function of time over a piece of the trapezoid, from ``time`` on.

    The pieces 0 to 2 belong to the contraction, and 3 to 5 to the extension. ``half`` is the duration of this half of
    the cycle, and ``time`` is the time since the start of the half, s. ``length_change`` is ΔL at this time.
    """
    ramp, speed = g.ramp_share * half, g.stroke / ((1.0 - g.ramp_share) * half)
    bend = speed / ramp
    place = piece % 3
    if place == 0:
        position, rate = 0.5 * bend * time * time, bend * time
    elif place == 1:
        position, rate, bend = speed * (time - 0.5 * ramp), speed, 0.0
    else:
        left = half - time
        position, rate, bend = g.stroke - 0.5 * bend * left * left, bend * left, -bend
    if piece < 3:
        position, rate, bend = -position, -rate, -bend
    else:
        position -= g.stroke
    target = a.gain * (position - g.pretension)
    return answer_to_parabola(length_change, target, a.gain * rate, a.gain * bend, a)


@compiled
def answer_to_part(
    part: int, begin: float, start: float, length_change: float, g: Any, a: Actuator
) -> tuple[Coefficients, float]:
    """Return ΔL (m) as a function of time over a part of a cycle, from ``start`` on, and its ω (1/s; 0 if none).

    ``begin`` is the start of the cycle, s. ``length_change`` is ΔL at ``start``, m.
    """
    if part in (0, PARTS - 1):
        return answer_to_line(length_change, -a.gain * a.slack, 0.0, a), 0.0
    share, origin, phase = g.contraction_share, begin, 0.0
    if part > 3:
        origin, phase, share = begin + share / g.frequency, math.pi, 1.0 - share
    if g.profile != COSINE:
        half = share / g.frequency
        return _answer_to_piece(part - 1, half, start - origin, length_change, g, a), 0.0
    omega = math.pi * g.frequency / share
    phase += omega * (start - origin)
    return answer_to_sinusoid(length_change, g.stroke, omega, phase, g.pretension, a), omega
