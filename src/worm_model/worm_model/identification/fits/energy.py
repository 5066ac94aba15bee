# SPDX-License-Identifier: Apache-2.0
"""Stage 7: bellows damping c_b and power factor α_P from accumulated energy (eq:energy_identification_cost).

P = P_idle + α_P·max(−F_c·L̇, 0) with F_c = H + k_b(L_free − L) − c_b·L̇ (eq:Fc). For a cable that cannot push,
max(F_c, 0) replaces F_c. H is the force of inertia, friction and fin on the rear module, from the locomotion fit. L and
L̇ are the measured length and its rate. The offset between the clocks of power sensor and camera is a nuisance parameter
of each run.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from worm_model.arrays import Array, accumulated
from worm_model.identification.data.observed_run import Recording
from worm_model.identification.fits.block_least_squares import (
    Problem,
    Quantity,
    Solution,
    solve,
    with_fixed,
)
from worm_model.simulation.kernel.sampled_energy import sampled_energy

CLOCK_SPREAD = 0.02  # s, prior standard deviation of the clock offset
SCALE = 0.05  # J, unit of the residuals; outliers exceed `block_least_squares.HUBER` units
# Effective number of independent residuals of a run. It is small, because accumulated energies are correlated.
INDEPENDENT = 20.0
KEYS = ("bellows_damping", "power_factor")
START = (860.0, 3.2)  # N·s/m and 1, values from which a fit starts: those of the paper, rounded
SHARED = (Quantity(5.0, 0.0, 1e5), Quantity(0.01, 0.05, 50.0))


@dataclass(frozen=True)
class PowerRun:
    """Data of one run for the energy model, from the onset to the end of the traverse (`locomotion.Traverse`).

    Attributes:
        recording: the run.
        time: time on the camera's clock, s, shape (n,).
        rate: L̇, m/s, shape (n,).
        static_force: cable force without the damping term, N, shape (n,).
        power_time, power: measured power, s and W, shape (m,).
        idle: idle power, W.
        one_sided_cable: True for a cable that cannot push.
    """

    recording: Recording
    time: Array
    rate: Array
    static_force: Array
    power_time: Array
    power: Array
    idle: float
    one_sided_cable: bool

    @property
    def energy(self) -> Array:
        """Measured energy since the first power sample, J, shape (m,)."""
        return accumulated(self.power_time, self.power)


@dataclass(frozen=True)
class EnergyFit:
    """Solution of `energy_problem`: c_b (N·s/m), α_P, and the clock offset of each run."""

    solution: Solution

    @property
    def damping(self) -> float:
        """c_b, N·s/m."""
        return float(self.solution.shared[0])

    @property
    def factor(self) -> float:
        """α_P."""
        return float(self.solution.shared[1])

    @property
    def clock_offset(self) -> Array:
        """Offset of the power sensor's clock from the camera's in each run, s, shape (runs,).

        Positive offsets mean early stamps of the sensor.
        """
        return self.solution.own[:, 0]

    @property
    def scatter(self) -> Array:
        """Root mean square of measured minus predicted energy in each run, J, shape (runs,)."""
        return SCALE * np.sqrt([np.mean(r**2) for r in self.solution.residuals])


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
    """Return the part of a run from the onset to ``end`` (s); for the other arguments see `PowerRun`."""
    kept = time <= end
    during = (recording.power_time >= 0.0) & (recording.power_time <= min(end, time[kept][-1]))
    return PowerRun(
        recording,
        time[kept],
        rate[kept],
        static_force[kept],
        recording.power_time[during],
        recording.power[during],
        idle,
        one_sided_cable,
    )


def predicted_energy(run: PowerRun, damping: float, factor: float, offset: float = 0.0) -> Array:
    """Return the predicted energy (J) since the first power sample, at the power samples, shape (m,).

    ``offset`` (s) is the clock offset, see `EnergyFit`. Outside of the run the power is the idle power.
    """
    return sampled_energy(
        run.time,
        run.rate,
        run.static_force,
        run.idle,
        run.one_sided_cable,
        damping,
        factor,
        run.power_time + offset,
    )


def energy_problem(runs: Sequence[PowerRun], scale: float = SCALE) -> Problem:
    """Return the least-squares problem of (c_b, α_P) and the clock offsets.

    The residuals are measured minus predicted accumulated energies, in units of ``scale`` (J).
    """
    measured = [run.energy for run in runs]

    def residuals(index: int, shared: Array, own: Array) -> Array:
        run = runs[index]
        predicted = predicted_energy(run, shared[0], shared[1], own[0])
        return (measured[index] - predicted) / scale

    own = (Quantity(1e-3, -0.1, 0.1, 0.0, CLOCK_SPREAD),)
    return Problem(residuals, SHARED, [own for _ in runs])


def sample_weights(runs: Sequence[PowerRun], weights: Array) -> list[Array]:
    """Return the weights of each run's samples. ``weights`` (runs,) are those of the runs, whatever their durations."""
    return [
        np.full(run.power_time.size, weight * INDEPENDENT / run.power_time.size)
        for run, weight in zip(runs, weights, strict=True)
    ]


def fit_energy(runs: Sequence[PowerRun], damping: float | None = None) -> EnergyFit:
    """Fit c_b and α_P, or only α_P for a given ``damping``. All runs have the same weight."""
    samples = sample_weights(runs, np.ones(len(runs)))
    problem = energy_problem(runs)
    shared, own = np.array(START), np.zeros((len(runs), 1))
    if damping is None:
        solution = solve(problem, shared, own, samples)
    else:
        held = solve(with_fixed(problem, 0, damping), shared[1:], own, samples)
        solution = replace(held, shared=np.insert(held.shared, 0, damping))
    return EnergyFit(solution)


def unseen_energy(damping: float, factor: float) -> EnergyFit:
    """Return a fit without any run, which contains the given c_b (N·s/m) and α_P."""
    return EnergyFit(Solution(np.array([damping, factor]), np.empty((0, 1)), (), 0.0))
