# SPDX-License-Identifier: Apache-2.0
"""Actuation law: slack clip (eq:slack_clip) and first-order lag (eq:first_order_actuation), exact.

All modules of this package that use the law import it from here: the waveform of a gait, sampled commands (straight
lines between samples), fits and the twin. The moments at which the command crosses −δ_s are located exactly. Between
them, the effective command min(u_cmd, −δ_s) is a constant, a line, a parabola or a sinusoid, and ΔL has a closed form,
the solution of τ·d(ΔL)/dt + ΔL = K·u_eff.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from worm_model.simulation.kernel.compiled import compiled, inlined, unlocked
from worm_model.simulation.kernel.linear import Coefficients


class Actuator(NamedTuple):
    """Parameters of the actuation: K in 1, δ_s in m, τ in s."""

    gain: float
    slack: float
    time_constant: float


@inlined
def effective(command: float, a: Actuator) -> float:
    """Return K·u_eff in m, towards which ΔL moves."""
    return a.gain * min(command, -a.slack)


@inlined
def rest_of(pretension: float, a: Actuator) -> float:
    """Return ΔL in m at the start of a run with a pretension in m. It is 0 without a pretension: the cable is slack."""
    return 0.0 if pretension == 0.0 else effective(-pretension, a)


@inlined
def answer_to_parabola(
    length_change: float, target: float, slope: float, bend: float, a: Actuator
) -> Coefficients:
    """Return ΔL (m) as a function of time, from its present value on.

    The target K·u_eff has the value ``target`` (m), the rate ``slope`` (m/s) and the constant second derivative
    ``bend`` (m/s²).
    """
    slope -= a.time_constant * bend
    behind = target - a.time_constant * slope
    rest = length_change - behind
    return Coefficients(behind, slope, 0.5 * bend, 0.0, 0.0, 0.0, rest, 0.0, 0.0, 0.0)


@inlined
def answer_to_line(length_change: float, target: float, slope: float, a: Actuator) -> Coefficients:
    """Return ΔL (m) as a function of time, from its present value on, for a target K·u_eff with a constant rate.

    ``target`` (m) is the present value of the target, and ``slope`` (m/s) its rate. ΔL finally lags the target by
    τ·slope; the initial deviation from this lag decays.
    """
    return answer_to_parabola(length_change, target, slope, 0.0, a)


@inlined
def answer_to_sinusoid(
    length_change: float, stroke: float, omega: float, phase: float, pretension: float, a: Actuator
) -> Coefficients:
    """Return ΔL (m) as a function of the time σ (s), from its present value on, for a sinusoidal command.

    The command is u_cmd = −o − S/2·(1 − cos(phase + ωσ)) and lies beyond the slack.
    """
    lag = omega * a.time_constant
    amplitude = 0.5 * a.gain * stroke / (1.0 + lag * lag)
    # amplitude·(cos(ωt) + lag·sin(ωt)), ωt = phase + ωσ
    cos = amplitude * (math.cos(phase) + lag * math.sin(phase))
    sin = amplitude * (lag * math.cos(phase) - math.sin(phase))
    mean = -a.gain * (pretension + 0.5 * stroke)
    rest = length_change - mean - cos
    return Coefficients(mean, 0.0, 0.0, 0.0, cos, sin, rest, 0.0, 0.0, 0.0)


@inlined
def value_at(form: Coefficients, time: float, omega: float, time_constant: float) -> float:
    """Return ΔL in m according to ``form``, which gives ΔL as a function of time, ``time`` s after its start."""
    wave = 0.0
    if omega != 0.0:
        wave = form.cos * math.cos(omega * time) + form.sin * math.sin(omega * time)
    line = form.one + (form.t1 + form.t2 * time) * time
    return line + wave + form.exp * math.exp(-time / time_constant)


@inlined
def crossing(start: float, end: float, a: Actuator) -> float:
    """Return the fraction of a linear change of the command at which the command crosses −δ_s; 1 if it does not."""
    before, after = start + a.slack, end + a.slack
    return before / (before - after) if before * after < 0.0 else 1.0


@compiled
def respond(length_change: float, start: float, end: float, duration: float, a: Actuator) -> float:
    """Return ΔL in m after a command (m) has moved in a straight line from start to end within a duration in s."""
    if duration <= 0.0:
        return length_change
    share = crossing(start, end, a)
    if share < 1.0:
        form = answer_to_line(
            length_change,
            effective(start, a),
            (effective(-a.slack, a) - effective(start, a)) / (share * duration),
            a,
        )
        length_change = value_at(form, share * duration, 0.0, a.time_constant)
        duration, start = (1.0 - share) * duration, -a.slack
    slope = (effective(end, a) - effective(start, a)) / duration
    form = answer_to_line(length_change, effective(start, a), slope, a)
    return value_at(form, duration, 0.0, a.time_constant)


@unlocked
def respond_at(
    times: np.ndarray,
    commands: np.ndarray,
    engaged: float,
    start: float,
    a: Actuator,
    at: np.ndarray,
    response: np.ndarray,
) -> None:
    """Fill ``response`` (m,) with ΔL in m at the times ``at`` (m,), for ``commands`` (n,) in m at ``times`` (n,) in s.

    All times ascend. Where two times are equal, the command steps. Outside of ``times``, the command keeps its first or
    last value. ΔL is ``start`` until ``engaged`` (s), and responds from this time on.
    """
    value, now, k = start, engaged, 0
    while k < times.size and times[k] <= engaged:
        k += 1
    command = commands[max(k - 1, 0)]
    if 0 < k < times.size:
        share = (engaged - times[k - 1]) / (times[k] - times[k - 1])
        command += share * (commands[k] - command)
    for j in range(at.size):
        while k < times.size and times[k] <= at[j]:
            value = respond(value, command, commands[k], times[k] - now, a)
            now, command = times[k], commands[k]
            k += 1
        if at[j] <= now:
            response[j] = value if at[j] >= engaged else start
            continue
        end = command
        if k < times.size:
            end += (at[j] - now) / (times[k] - now) * (commands[k] - command)
        response[j] = respond(value, command, end, at[j] - now, a)
