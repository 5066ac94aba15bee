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
_MOST_TIMES = 800  # of the coarse search, for slow gaits
_AROUND_S = 0.12  # range of the refined time about the coarse one
_AFTER_TURN_S = 0.12  # a fin can switch shortly after the turning point, and its jump takes 0.1 s
_WINDOW_S = (0.15, 0.45)  # shortest and longest half window
_WINDOW_TRAVEL = 0.4  # of a pitch; half window as a travel
_LEAST_TRAVEL = 0.6  # of p_sw + δ_c/2, before which no fin can switch
_SPACING = 0.0007  # m, standard deviation of the travel between two switches about a pitch
_FEWEST_SAMPLES = 5  # about a switch
_SURE = 5.0  # log evidence above which there is a switch
_TEMPLATE_ERROR_M = 0.0001  # standard deviation of the motion of a healthy robot from the template
# Standard deviations of the priors: of the slopes (1), also after the turning point; of the jump (relative); offset (m)
_SLOPE, _TURNED, _JUMP, _OFFSET = 0.15, 0.5, 0.25, 0.05


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

    def at(self, time: Array, low: Array, high: Array) -> Array:
        """Return the log evidence of a switch at each time (n,), from the samples between two times (n,) each.

        It is 0 with fewer than five samples.
        """
        first, last = np.searchsorted(self._time, low), np.searchsorted(self._time, high)
        rows = first[:, np.newaxis] + np.arange(max(int((last - first).max(initial=0)), 1))
        used = rows < last[:, np.newaxis]
        rows = np.minimum(rows, self._time.size - 1)
        at, travel = self._time[rows], self._travel[rows]
        moment = time[:, np.newaxis]
        now = np.interp(moment, self._time, self._travel)
        after, law = at > moment, self._law
        turned = np.where(at > self._turn[0], travel - self._turn[1], 0.0)
        jump = np.where(after, 1.0 - np.exp(-np.maximum(at - moment, 0.0) / law.time_constant), 0.0)
        since = np.where(after, travel - now, 0.0)
        terms = used[:, np.newaxis] * np.stack(
            [np.ones(at.shape), now - travel, turned, jump, since], axis=1
        )
        holding = self._holding[rows]
        mean = (holding * used).sum(axis=1) / np.maximum(used.sum(axis=1), 1)
        centred = used * (holding - mean[:, np.newaxis])
        expected = np.array([0.0, law.slope, 0.0, law.jump, law.slope])
        spread = np.array([_OFFSET, _SLOPE, _TURNED, _JUMP * law.jump, _SLOPE])
        with_switch = self._log_evidence(terms, centred, expected, spread)
        without = self._log_evidence(terms[:, :3], centred, expected[:3], spread[:3])
        return np.where(last - first < _FEWEST_SAMPLES, 0.0, with_switch - without)

    def _log_evidence(self, terms: Array, values: Array, expected: Array, spread: Array) -> Array:
        """Return the log evidence (n,) of linear models with normal priors, without terms common to all models.

        ``terms`` (n, p, m) are the terms at the samples, ``values`` (n, m) the samples.
        """
        rest = (values - np.einsum("p,npm->nm", expected, terms)) / self._noise
        scaled = terms * (spread / self._noise)[:, np.newaxis]
        precision = np.eye(expected.size) + scaled @ scaled.transpose(0, 2, 1)
        moment = scaled @ rest[:, :, np.newaxis]
        explained = (moment * np.linalg.solve(precision, moment)).sum(axis=(1, 2))
        determinant = np.linalg.slogdet(precision)[1]
        return np.asarray(0.5 * (explained - (rest**2).sum(axis=1) - determinant))


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
    grid = np.arange(half.start, last, max(_COARSE_S, (last - half.start) / _MOST_TIMES))
    travel = half.travel(motion.length_at(grid))
    possible = travel > _LEAST_TRAVEL * (p.switching_threshold + 0.5 * p.clearance)
    grid, travel = grid[possible], travel[possible]
    if grid.size < 3 or count == 0:
        return NONE
    windows = _half_windows(grid, travel, p.pitch)
    end = last + _AFTER_TURN_S
    score = evidence.at(
        grid, np.maximum(grid - windows, half.start), np.minimum(grid + windows, end)
    )
    if usual is not None:
        off = np.abs(travel - np.reshape(usual[0], (-1, 1))).min(axis=0)
        score -= 0.5 * (off / usual[1]) ** 2
    rows = _comb(score, travel, grid < half.end, p.pitch, count)
    if not rows:
        return NONE
    coarse, window = grid[rows[-1]], windows[rows[-1]]
    fine = np.arange(coarse - _AROUND_S, coarse + _AROUND_S, _FINE_S)
    span = (
        np.full(fine.size, max(coarse - window, half.start)),
        np.full(fine.size, min(coarse + window, end)),
    )
    log = evidence.at(fine, *span)
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
    rows_before = np.flatnonzero(ascending)
    earlier: list[NDArray[np.int64]] = []
    goes_on = np.full(score.size, rows_before.size > 0)
    for step in range(1, count or int(travel.max() / pitch) + 1):
        distance = travel[rows_before] - (travel[:, np.newaxis] - step * pitch)
        gain = score[rows_before] - 0.5 * (distance / (_SPACING * step**0.5)) ** 2
        best = gain.argmax(axis=1) if rows_before.size else np.zeros(score.size, np.int64)
        value = gain.max(axis=1, initial=-np.inf)
        goes_on &= (value >= _SURE) | (count is not None)
        total += np.where(goes_on, np.maximum(value, -_SURE), 0.0)
        earlier.insert(0, np.where(goes_on, rows_before[best] if rows_before.size else -1, -1))
    last = int(np.argmax(total))
    if total[last] <= _SURE or score[last] <= 0.0:
        return []
    return [*(int(rows[last]) for rows in earlier if rows[last] >= 0), last]
