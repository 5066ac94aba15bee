# SPDX-License-Identifier: Apache-2.0
"""Stage 7: bellows damping c_b and power factor α_P from accumulated energy (eq:energy_identification_cost).

P = P_idle + α_P·max(−F_c·L̇, 0), or max(F_c, 0) in the place of F_c for a cable that cannot push, with
F_c = H + k_b(L_free − L) − c_b·L̇ (eq:Fc): H, what friction and fin hold of the rear module, comes from the locomotion
fit, L and L̇ from the measured length. The clock of the power sensor may be off the camera's: a nuisance of each run.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from worm_model.arrays import Array
from worm_model.identification.block_least_squares import (
    Problem,
    Quantity,
    Solution,
    solve,
    with_fixed,
)
from worm_model.identification.observed_run import Recording
from worm_model.simulation.kernel.work import cable_power
from worm_model.simulation.quadrature import accumulated

CLOCK_SPREAD = 0.02  # s
SCALE = 0.05  # J, of a residual: beyond some of these a sample counts as an outlier
INDEPENDENT = 20.0  # residuals that a run is worth: those of an accumulated energy wander and resemble their neighbours
KEYS = ("bellows_damping", "power_factor")
START = (860.0, 3.2)  # the paper's, rounded
SHARED = (Quantity(5.0, 0.0, 1e5), Quantity(0.01, 0.05, 50.0))


@dataclass(frozen=True)
class PowerRun:
    """What the energy model needs of a run, over its five ridges.

    ``time`` (n,) s on the camera's clock with ``rate`` L̇ m/s and ``static_force`` N, the cable force but for its
    damping; ``power_time`` (m,) s and ``power`` (m,) W as measured; ``idle`` W; ``one_sided_cable``: the power's form.
    """

    name: str
    time: Array
    rate: Array
    static_force: Array
    power_time: Array
    power: Array
    idle: float
    one_sided_cable: bool

    @property
    def energy(self) -> Array:
        """(m,) J, measured since the first of its samples."""
        return accumulated(self.power_time, self.power)


@dataclass(frozen=True)
class EnergyFit:
    """``damping`` N·s/m and ``factor``; of each run ``clock_offset`` s and the ``residuals`` of energy in J."""

    damping: float
    factor: float
    clock_offset: Array
    residuals: tuple[Array, ...]
    solution: Solution


def power_run(
    recording: Recording,
    time: Array,
    rate: Array,
    static_force: Array,
    end: float,
    idle: float,
    *,
    one_sided_cable: bool,
) -> PowerRun:
    """The part of a run from the onset to ``end`` s."""
    kept = time <= end
    during = (recording.power_time >= 0.0) & (recording.power_time <= min(end, time[kept][-1]))
    return PowerRun(
        recording.name,
        time[kept],
        rate[kept],
        static_force[kept],
        recording.power_time[during],
        recording.power[during],
        idle,
        one_sided_cable,
    )


def predicted_power(run: PowerRun, damping: float, factor: float) -> Array:
    """Source power in W at ``run.time``."""
    force = run.static_force - damping * run.rate
    power: Array = run.idle + factor * cable_power(force, run.rate, run.one_sided_cable)
    return power


def predicted_energy(run: PowerRun, damping: float, factor: float, offset: float = 0.0) -> Array:
    """Energy in J at ``run.power_time``, from the first of them on; the sensor's stamps are early by ``offset`` s."""
    energy = accumulated(run.time, predicted_power(run, damping, factor))
    at = run.power_time + offset
    # Beyond its ends the run idles.
    inside = np.interp(at, run.time, energy)
    idle = np.minimum(at - run.time[0], 0.0) + np.maximum(at - run.time[-1], 0.0)
    values = inside + run.idle * idle
    return values - values[0]


def energy_problem(runs: Sequence[PowerRun], scale: float = SCALE) -> Problem:
    """Residuals of the accumulated energy by (c_b, α_P) and each run's clock offset, in units of ``scale`` J."""
    measured = [run.energy for run in runs]

    def residuals(index: int, shared: Array, own: Array) -> Array:
        run = runs[index]
        predicted = predicted_energy(run, shared[0], shared[1], own[0])
        return (measured[index] - predicted) / scale

    own = (Quantity(1e-3, -0.1, 0.1, 0.0, CLOCK_SPREAD),)
    return Problem(residuals, SHARED, [own for _ in runs])


def fit_energy(
    runs: Sequence[PowerRun],
    weights: Array | None = None,
    start: EnergyFit | None = None,
    damping: float | None = None,
) -> EnergyFit:
    """Fits c_b and α_P, or α_P alone under a given ``damping``; ``weights`` (runs,), by default 1, are the runs'.

    Every run counts alike, however long.
    """
    weight = np.ones(len(runs)) if weights is None else weights
    samples = [
        np.full(run.power_time.size, w * INDEPENDENT / run.power_time.size)
        for run, w in zip(runs, weight, strict=True)
    ]
    problem = energy_problem(runs)
    shared = np.array(START) if start is None else start.solution.shared
    own = np.zeros((len(runs), 1)) if start is None else start.solution.own
    if damping is None:
        solution = solve(problem, shared, own, samples)
    else:
        held = solve(with_fixed(problem, 0, damping), shared[1:], own, samples)
        solution = replace(held, shared=np.insert(held.shared, 0, damping))
    return EnergyFit(
        damping=float(solution.shared[0]),
        factor=float(solution.shared[1]),
        clock_offset=solution.own[:, 0],
        residuals=tuple(r * SCALE for r in solution.residuals),
        solution=solution,
    )


def unseen_energy(damping: float, factor: float) -> EnergyFit:
    """The values as they are given, where no run was seen."""
    nothing = Solution(np.array([damping, factor]), np.empty((0, 1)), (), 0.0)
    return EnergyFit(damping, factor, np.empty(0), (), nothing)
