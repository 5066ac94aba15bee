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
from worm_model.simulation.closed_form import deflected_share, switching_force
from worm_model.simulation.kernel.switch_template import log_evidence

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
_BENT = 0.4  # the same of a change of slope without a switch, as when the holding fin engages


@dataclass(frozen=True)
class Switches:
    """Switches of a half cycle: their times in s, ascending, and the standard deviation of the last one, s."""

    times: tuple[float, ...]
    last_sd: float


NONE = Switches((), float("nan"))


class Evidence:
    """Log evidence of a switch of the sliding fin, as a function of its time."""

    def __init__(self, motion: Motion, half: HalfCycle, parameters: Parameters) -> None:
        travel = half.travel(motion.length)
        turned = travel - half.whole_travel
        turned[motion.time <= half.end] = 0.0
        self._samples = np.stack([motion.time, travel, turned, motion.holding(half.fin)])
        # Effect of the sliding fin on the holding module: slope (1), jump (m) and time constant of the jump (s)
        slope = 1.0 - deflected_share(parameters)
        jump = switching_force(parameters) / parameters.engaged_stiffness
        self._time_constant = 2.0 * parameters.viscous_friction / parameters.engaged_stiffness
        # The smoothed length adds a part of its own noise to that of the mean of both modules.
        self._noise = float(np.hypot(0.8 * motion.noise, _TEMPLATE_ERROR_M))
        # means and standard deviations of the priors with a switch, and without
        self._models = np.array(
            [
                [[0.0, slope, 0.0, slope, jump], [_OFFSET, _SLOPE, _TURNED, _SLOPE, _JUMP * jump]],
                [[0.0, slope, 0.0, 0.0, 0.0], [_OFFSET, _SLOPE, _TURNED, _BENT, 0.0]],
            ]
        )

    def at(self, time: Array, low: Array, high: Array) -> Array:
        """Return the log evidence of a switch at each time (n,), from the samples between two times (n,) each.

        Without a switch, the slope may change at this time, as when the holding fin engages. The result is 0 with fewer
        than five samples.
        """
        windows = np.searchsorted(self._samples[0], [low, high])
        evidence = self._log_evidence(time, windows, self._models)
        few = windows[1] - windows[0] < _FEWEST_SAMPLES
        return np.where(few, 0.0, evidence[:, 0] - evidence[:, 1])

    def of_time(self, time: Array, low: float, high: float) -> Array:
        """Return the log likelihood of the times (n,) of a switch that is known to be between two times."""
        window = np.searchsorted(self._samples[0], [low, high])
        windows = np.repeat(window[:, np.newaxis], time.size, axis=1)
        return self._log_evidence(time, windows, self._models[:1])[:, 0]

    def _log_evidence(self, time: Array, windows: NDArray[np.int64], models: Array) -> Array:
        now = np.interp(time, *self._samples[:2])
        return log_evidence(
            self._samples, time, now, windows, self._time_constant, self._noise, models
        )


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
    evidence = Evidence(motion, half, p)
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
    log = evidence.of_time(fine, max(coarse - window, half.start), min(coarse + window, end))
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
    if not rows_before.size:
        return []
    goes_on = np.ones(score.size, dtype=bool)
    for step in range(1, count or int(travel.max() / pitch) + 1):
        distance = travel[rows_before] - (travel[:, np.newaxis] - step * pitch)
        gain = score[rows_before] - 0.5 * (distance / (_SPACING * step**0.5)) ** 2
        gain[rows_before >= np.arange(score.size)[:, np.newaxis]] = -np.inf
        value = gain.max(axis=1)
        goes_on &= (value >= _SURE) | (count is not None)
        total += np.where(goes_on, np.maximum(value, -_SURE), 0.0)
        known = goes_on & np.isfinite(value)
        earlier.insert(0, np.where(known, rows_before[gain.argmax(axis=1)], -1))
    last = int(np.argmax(total))
    # Of a fin that is known to have switched, the best time counts.
    if total[last] <= (_SURE if count is None else 0.0):
        return []
    return [*(int(rows[last]) for rows in earlier if rows[last] >= 0), last]
