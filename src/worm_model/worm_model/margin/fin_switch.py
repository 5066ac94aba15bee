# SPDX-License-Identifier: Apache-2.0
"""Times at which a sliding fin switches, from the motion of the holding module.

Before a switch the force of the sliding fin grows with the travel of the body and drags the holding module backward, by
k_dis/(k_dis + k_eng) per travel (eq:fin_force_piecewise). The switch releases this force: the holding module jumps
forward by k_dis·(p_sw − δ_c/2)/k_eng, with the time constant 2η/k_eng of its fin, and stays there until the sliding fin
touches the next ridge. `Evidence` compares the samples with this template and with a template without a switch. Slopes
and jump are fitted with the model's values as priors, so it tolerates robots that differ from the model.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from worm_model.arrays import Array
from worm_model.margin.half_cycles import HalfCycle, Motion
from worm_model.parameters import Parameters

_COARSE_S, _FINE_S = 0.01, 0.003
_AROUND_S = 0.12  # range of the refined time about the coarse one
_AFTER_TURN_S = 0.12  # a fin can switch shortly after the turning point, and its jump takes 0.1 s
_WINDOW_S = (0.15, 0.45)  # shortest and longest half window
_WINDOW_TRAVEL = 0.4  # of a pitch; half window as a travel
_LEAST_TRAVEL = 0.6  # of p_sw + δ_c/2, before which no fin can switch
_SPACING = 0.0007  # m, standard deviation of the travel between two switches about a pitch
_SURE = 5.0  # log evidence above which there is a switch
_TEMPLATE_ERROR_M = 0.0001  # standard deviation of the motion of a healthy robot from the template
# Standard deviations of the priors: of the slopes (1), also after the turning point; of the jump (relative); offset (m)
_SLOPE, _TURNED, _JUMP, _OFFSET = 0.15, 0.5, 0.25, 0.05
_BENT = 0.4  # the same of a change of slope without a switch, as when the holding fin engages


@dataclass(frozen=True)
class FinLaw:
    """Effect of the sliding fin on the holding module: slope (1), jump (m) and time constant of the jump (s)."""

    slope: float
    jump: float
    time_constant: float

    @classmethod
    def of(cls, parameters: Parameters) -> FinLaw:
        """Return the effect for the fins of the model."""
        p = parameters
        released = p.disengaged_stiffness * (p.switching_threshold - 0.5 * p.clearance)
        return cls(
            p.disengaged_stiffness / (p.disengaged_stiffness + p.engaged_stiffness),
            released / p.engaged_stiffness,
            2.0 * p.viscous_friction / p.engaged_stiffness,
        )


@dataclass(frozen=True)
class Switches:
    """Switches of a half cycle: their times in s, ascending, and the standard deviation of the last one, s."""

    times: tuple[float, ...]
    last_sd: float


NONE = Switches((), float("nan"))


class Evidence:
    """Log evidence of a switch of the sliding fin, as a function of its time."""

    def __init__(self, motion: Motion, half: HalfCycle, law: FinLaw) -> None:
        self._time = motion.time
        self._holding = motion.holding(half.fin)
        self._travel = half.travel(motion.length)
        self._turn = half.end, float(half.travel(np.asarray(half.end_length)))
        self._law = law
        # The smoothed length adds a part of its own noise to that of the mean of both modules.
        self._noise = float(np.hypot(0.8 * motion.noise, _TEMPLATE_ERROR_M))

    def at(self, time: float, low: float, high: float) -> float:
        """Return the log evidence of a switch at a time from the samples between two times, 0 without any.

        Without a switch, the slope may change at this time, as when the holding fin engages.
        """
        terms, values = self._terms(time, low, high)
        if values.size < 5:
            return 0.0
        without = self._log_evidence(
            terms[:-1], values, [0.0, self._law.slope, 0.0, 0.0], [_OFFSET, _SLOPE, _TURNED, _BENT]
        )
        return self._switched(terms, values) - without

    def of_time(self, time: float, low: float, high: float) -> float:
        """Return the log likelihood of the time of a switch that is known to be between two times."""
        return self._switched(*self._terms(time, low, high))

    def _switched(self, terms: Array, values: Array) -> float:
        law = self._law
        return self._log_evidence(
            terms,
            values,
            [0.0, law.slope, 0.0, law.slope, law.jump],
            [_OFFSET, _SLOPE, _TURNED, _SLOPE, _JUMP * law.jump],
        )

    def _terms(self, time: float, low: float, high: float) -> tuple[Array, Array]:
        """Return the terms (5, n) of the template, the jump last, and the position of the holding module (n,), m."""
        rows = slice(*np.searchsorted(self._time, (low, high)))
        at, travel = self._time[rows], self._travel[rows]
        now = np.interp(time, self._time, self._travel)
        after = at > time
        turned = np.where(at > self._turn[0], travel - self._turn[1], 0.0)
        bent = np.where(after, travel - now, 0.0)
        elapsed = np.maximum(at - time, 0.0) / self._law.time_constant
        terms = np.stack([np.ones(at.size), now - travel, turned, bent, -np.expm1(-elapsed)])
        return terms, self._holding[rows] - self._holding[rows].mean() if at.size else at

    def _log_evidence(
        self, terms: Array, values: Array, expected: list[float], spread: list[float]
    ) -> float:
        """Return the log evidence of a linear model with normal priors, without terms common to all models."""
        rest = (values - np.array(expected) @ terms) / self._noise
        scaled = terms * np.array(spread)[:, np.newaxis] / self._noise
        precision = np.eye(len(expected)) + scaled @ scaled.T
        moment = scaled @ rest
        explained = moment @ np.linalg.solve(precision, moment)
        return float(-0.5 * (rest @ rest - explained) - 0.5 * np.linalg.slogdet(precision)[1])


def find_switches(
    motion: Motion,
    half: HalfCycle,
    parameters: Parameters,
    count: int | None,
    usual: tuple[Array, float] | None = None,
) -> Switches:
    """Return the switches of a half cycle.

    Args:
        motion: measured motion of the run.
        half: the half cycle.
        parameters: parameters of the fins, the friction and the pitch.
        count: number of grooves by which the sliding fin moved; None: unknown.
        usual: possible travels (m) of the last switch, from other cycles, and their standard deviation.
    """
    p = parameters
    evidence = Evidence(motion, half, FinLaw.of(p))
    last = min(half.end + _AFTER_TURN_S, motion.time[-1])
    grid = np.arange(half.start, last, _COARSE_S)
    travel = half.travel(motion.length_at(grid))
    possible = travel > _LEAST_TRAVEL * (p.switching_threshold + 0.5 * p.clearance)
    grid, travel = grid[possible], travel[possible]
    if grid.size < 3 or count == 0:
        return NONE
    windows = _half_windows(grid, travel, p.pitch)
    end = last + _AFTER_TURN_S
    score = np.array(
        [
            evidence.at(time, max(time - half_window, half.start), min(time + half_window, end))
            for time, half_window in zip(grid, windows, strict=True)
        ]
    )
    if usual is not None:
        off = np.abs(travel - np.reshape(usual[0], (-1, 1))).min(axis=0)
        score -= 0.5 * (off / usual[1]) ** 2
    rows = _comb(score, travel, grid < half.end, p.pitch, count)
    if not rows:
        return NONE
    coarse, window = grid[rows[-1]], windows[rows[-1]]
    fine = np.arange(coarse - _AROUND_S, coarse + _AROUND_S, _FINE_S)
    span = max(coarse - window, half.start), min(coarse + window, end)
    log = np.array([evidence.of_time(time, *span) for time in fine])
    weight = np.exp(log - log.max())
    weight /= weight.sum()
    mean = float(weight @ fine)
    sd = float(np.sqrt(weight @ (fine - mean) ** 2))
    return Switches((*(float(grid[row]) for row in rows[:-1]), mean), sd)


def _half_windows(grid: Array, travel: Array, pitch: float) -> Array:
    """Return the half window (s) of each time: a part of the time in which the body travels a pitch."""
    rate = np.abs(np.gradient(travel, grid))
    return np.clip(_WINDOW_TRAVEL * pitch / np.maximum(rate, 1e-4), *_WINDOW_S)


def _comb(
    score: Array, travel: Array, ascending: NDArray[np.bool_], pitch: float, count: int | None
) -> list[int]:
    """Return the rows of the most probable switches, the last one last; successive ones are a pitch apart.

    ``ascending`` (n,) is True before the turning point: only the last switch can be after it.
    """
    total = score.copy()
    earlier: list[list[int]] = [[] for _ in score]
    longest = count or int(travel.max() / pitch) + 1
    rows_before = np.flatnonzero(ascending)
    for row in range(score.size):
        for step in range(1, longest):
            distance = (travel[rows_before] - (travel[row] - step * pitch)) / (_SPACING * step**0.5)
            gain = np.where(rows_before < row, score[rows_before] - 0.5 * distance**2, -np.inf)
            best = int(np.argmax(gain)) if gain.size else -1
            if best < 0 or (count is None and gain[best] < _SURE):
                break
            total[row] += max(float(gain[best]), -_SURE)
            earlier[row].insert(0, int(rows_before[best]))
    best = int(np.argmax(total))
    least = _SURE if count is None else 0.0  # the best time of a fin that is known to switch
    return [*earlier[best], best] if total[best] > least else []
