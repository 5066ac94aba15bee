# SPDX-License-Identifier: Apache-2.0
"""The estimated length: the actuation model answering the command sample by sample, exactly.

The command is taken as piecewise linear between its samples, the slack clip (eq:slack_clip) is split where
the command crosses −δ_s, and the first-order lag (eq:first_order_actuation) answers each ramp in closed form.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from worm_model.gait import Gait
from worm_model.parameters import Parameters
from worm_model.twin.records import NANOSECONDS


@dataclass(frozen=True)
class Actuation:
    """At ``stamp_ns``: the ``command`` u_cmd, ΔL and its rate, in m and m/s.

    Until ``engaged`` the slack is not taken up and the body keeps its length.
    """

    stamp_ns: int
    command: float = 0.0
    length_change: float = 0.0
    rate: float = 0.0
    engaged: bool = False


def engage(stamp_ns: int, parameters: Parameters) -> Actuation:
    """The onset of a run: ΔL = 0, the body starts to follow the slack that is taken up at once."""
    rate = -parameters.gain * parameters.slack / parameters.time_constant
    return Actuation(stamp_ns, 0.0, 0.0, rate, engaged=True)


def respond(before: Actuation, stamp_ns: int, command: float, parameters: Parameters) -> Actuation:
    """The state at a later stamp, the command moving in a straight line to ``command`` (m)."""
    if not before.engaged:
        return Actuation(stamp_ns, command)
    duration = (stamp_ns - before.stamp_ns) / NANOSECONDS
    value, start = before.length_change, before.command
    slack = -parameters.slack
    if (start - slack) * (command - slack) < 0.0:
        share = (slack - start) / (command - start)
        value = _ramp(value, start, slack, share * duration, parameters)
        duration, start = (1.0 - share) * duration, slack
    value = _ramp(value, start, command, duration, parameters)
    rate = (parameters.gain * min(command, slack) - value) / parameters.time_constant
    return Actuation(stamp_ns, command, value, rate, engaged=True)


def _ramp(value: float, start: float, end: float, duration: float, parameters: Parameters) -> float:
    """ΔL after a ramp of the command on one side of the clip; it lags the ramp by τ·slope."""
    if duration <= 0.0:
        return value
    first = parameters.gain * min(start, -parameters.slack)
    last = parameters.gain * min(end, -parameters.slack)
    lag = parameters.time_constant * (last - first) / duration
    return last - lag + (value - first + lag) * math.exp(-duration / parameters.time_constant)


def join(
    gait: Gait, onset_ns: int, stamp_ns: int, parameters: Parameters, step_s: float = 0.01
) -> Actuation:
    """The state at a stamp after the onset of a gait whose commands nobody heard, as if it had been played exactly."""
    state = engage(onset_ns, parameters)
    # A late joiner needs no more than the last cycles: the lag forgets the rest.
    cycles = max(0, int((stamp_ns - onset_ns) / NANOSECONDS * gait.frequency) - 1)
    state = replace(state, stamp_ns=onset_ns + round(cycles * gait.period * NANOSECONDS))
    while state.stamp_ns < stamp_ns:
        stamp = min(state.stamp_ns + round(step_s * NANOSECONDS), stamp_ns)
        command = gait.command((stamp - onset_ns) / NANOSECONDS)
        state = respond(state, stamp, command, parameters)
    return state
