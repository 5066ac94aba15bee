# SPDX-License-Identifier: Apache-2.0
"""Margin of a switch in the paper's unit: the increase of the switching threshold that it would still have stood.

Without its switch, the sliding fin would have been deflected further, by the part κ = k_eng/(k_eng + k_dis) of the
remaining travel of the body. Two effects change this. The module lags behind the body, with the time constant
2η/(k_eng + k_dis): it moves on for a moment after the turning point. And the released force lets a body with a
compliant cable travel further, which it would not have done without the switch.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_ndtr

from worm_model.arrays import Array
from worm_model.gait import Gait
from worm_model.margin.half_cycles import Fin, HalfCycle, Motion
from worm_model.parameters import Parameters
from worm_model.simulation.closed_form import deflected_share, switching_force

_AFTER_S = 0.35  # s after the turning point in which a lagging fin is deflected most
_KINK_WINDOW_S = (0.3, 0.35)
_STEP_S = 0.01
_TAUT_M = 0.012  # travel after which the cable pulls
# m by which the fin's deflection falls short at the turning point, because the modules and the fins have dry friction
# that the model lacks; SHARED_SD_M is the standard deviation of this and other errors that all cycles of a run share
_SHORTFALL_M = 0.0003
SHARED_SD_M = 0.0002
# relative standard deviations of the deflection per travel, because a fin may stiffen and a taut cable yields to it,
# and of the rate of a release (to the largest one), because the background of a kink takes a part; 0: not observed
_SHARE_ERROR = {Fin.REAR: 0.1, Fin.FRONT: 0.0}
_KINK_ERROR = {Fin.REAR: 0.25, Fin.FRONT: 0.0}
# s, time constants with which a released body comes to rest: (c_b/(k_b + k_cable)) with a taut cable, and longer with
# a slack one, as in an extension
_SETTLING_S = {Fin.REAR: 0.12, Fin.FRONT: 0.3}


def step_response(time: Array, time_constant: float) -> Array:
    """Return the response of a first-order system to a unit step at time 0, at times in s."""
    return np.asarray(-np.expm1(-np.maximum(time, 0.0) / time_constant))


@dataclass(frozen=True)
class Release:
    """Additional rate of travel after a switch, m/s, its standard deviation, and the time constant of its decay, s."""

    rate: float
    sd: float
    time_constant: float

    def travel(self, time: Array) -> Array:
        """Return the additional travel (m) at times after the switch in s."""
        return self.rate * self.time_constant * step_response(time, self.time_constant)


def release_of(
    motion: Motion, switches: Sequence[tuple[HalfCycle, float]], gait: Gait, parameters: Parameters
) -> Release:
    """Return the release of a fin from the kink of the length at its switches (half cycle, time in s).

    A rigid body has none, a body on bellows alone F/c_b with the released force F. The prior contains both.
    """
    p = parameters
    fin = switches[0][0].fin if switches else Fin.REAR
    settling = _SETTLING_S[fin]
    largest = switching_force(p) / p.bellows_damping
    mean, precision = 0.5 * largest, 1.0 / (0.5 * largest) ** 2
    moment = mean * precision
    groups = _taut(motion, switches) if fin is Fin.REAR else _slack(motion, switches)
    for half, rows, times in groups:
        at = motion.time[rows]
        background = (
            np.stack([np.ones(at.size), gait.command(at), np.gradient(gait.command(at), at)], 1)
            if fin is Fin.REAR
            else np.vander(at - times[0], 4)
        )
        kink = sum(settling * step_response(at - time, settling) for time in times)
        # the kink less its part that the background explains, the partial regression of the travel on the kink
        own = kink - background @ np.linalg.lstsq(background, kink, rcond=None)[0]
        travel = half.travel(motion.front[rows] - motion.rear[rows])
        moment += float(own @ travel) / (2.0 * motion.noise**2)
        precision += float(own @ own) / (2.0 * motion.noise**2)
    rate = moment / precision
    sd = math.hypot(precision**-0.5, _KINK_ERROR[fin] * largest)
    return Release(float(np.clip(rate, 0.0, largest)), sd, settling)


# samples and switches that are fitted together
_Group = tuple[HalfCycle, NDArray[np.bool_], list[float]]


def _taut(motion: Motion, switches: Sequence[tuple[HalfCycle, float]]) -> Iterator[_Group]:
    """Yield each contraction once the cable pulls: the length then follows the command and its rate."""
    for half, pairs in groupby(switches, lambda pair: pair[0]):
        travel = half.travel(motion.length)
        rows = (motion.time > half.start) & (motion.time < half.end + 0.05) & (travel > _TAUT_M)
        if np.count_nonzero(rows) >= 8:
            yield half, rows, [time for _, time in pairs]


def _slack(motion: Motion, switches: Sequence[tuple[HalfCycle, float]]) -> Iterator[_Group]:
    """Yield a window about each switch of an extension, in which the length is nearly a cubic."""
    for half, time in switches:
        after = min(_KINK_WINDOW_S[1], half.end - time)
        rows = (motion.time > time - _KINK_WINDOW_S[0]) & (motion.time < time + after)
        if after > 0.1 and np.count_nonzero(rows) >= 8:
            yield half, rows, [time]


def threshold_margin(
    motion: Motion, half: HalfCycle, switch: float, release: Release, parameters: Parameters
) -> float:
    """Return the increase of the switching threshold (m) that a switch at a time (s) would still have stood."""
    p = parameters
    share = deflected_share(p)
    lag = 2.0 * p.viscous_friction / p.engaged_stiffness * share
    until = min(max(half.end, switch) + _AFTER_S, motion.time[-1])
    time = np.arange(switch - 4.0 * lag, until, _STEP_S)
    travel = half.travel(motion.length_at(time)) - release.travel(time - switch)
    force = -(share - 0.5) * np.gradient(travel, time) * lag
    decay = np.exp(-_STEP_S / lag)
    response = (1.0 - decay) * decay ** np.arange(time.size)
    # the module's position relative to the equilibrium of the fins' forces, to which it lags
    behind = force[0] + np.convolve(force - force[0], response)[: time.size]
    deflection = share * travel + behind
    now = float(np.interp(switch, time, deflection))
    return float(deflection[time >= switch].max(initial=now)) - now - _SHORTFALL_M


def margin_sd(
    half: HalfCycle, switch: float, length: float, length_sd: float, release: Release, share: float
) -> float:
    """Return the standard deviation of a margin (m).

    Args:
        half: half cycle of the switch.
        switch: its time, s.
        length: remaining travel, m.
        length_sd: its standard deviation, m.
        release: release of the fin.
        share: deflection per travel.
    """
    remaining = np.asarray(half.end - switch)
    effect = release.time_constant * float(step_response(remaining, release.time_constant))
    return share * math.hypot(length_sd, release.sd * effect, _SHARE_ERROR[half.fin] * length)


def negative_margin(margin: float, sd: float) -> float:
    """Return the mean (m) of a normal margin that is known to be negative, because a groove was missed."""
    ratio = margin / sd
    return margin - sd * math.exp(-0.5 * ratio**2 - float(log_ndtr(-ratio))) / math.sqrt(math.tau)
