# SPDX-License-Identifier: Apache-2.0
"""Stage 7: c_b and α_P with intervals from a bootstrap over runs.

Each refit draws random weights of the runs. It also draws k_b, L_free and the locomotion fit (friction and fin
parameters) within their uncertainty, and computes the static forces from them. Gaits of a single frequency cannot
separate c_b from α_P, because the effects of both are then proportional. In this case both estimates are not
identifiable, and their notes state the reason.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from worm_model.arrays import Array
from worm_model.identification.fits import energy
from worm_model.identification.fits.block_least_squares import solve
from worm_model.identification.fits.estimate import VAGUE, Estimate, not_identifiable, quantile
from worm_model.identification.fits.locomotion import Traverse
from worm_model.identification.fits.resampling import REFITS, correlation, estimates, unit_weights
from worm_model.identification.locomotion_stage import LocomotionResult, holding_forces
from worm_model.parameters import Parameters

# Smallest ratio of the highest to the lowest gait frequency that separates c_b from α_P
LEAST_FREQUENCY_RATIO = 1.4
FEWEST_RUNS = 2
NO_POWER = (
    "no run has power samples from the onset until the rear module has passed five ridges: record the power until the "
    "run ends"
)
NOT_SEPARATED = (
    "the interval of {} is unknown or wider than half the value on either side, so the "
    "data do not separate c_b from α_P"
)


@dataclass(frozen=True)
class EnergyResult:
    """Result of stage 7.

    Attributes:
        bellows_damping, power_factor: estimates, N·s/m and 1.
        correlation: correlation of both estimates, shape (2, 2).
        inherited: for each estimate, the share of its variance that is due to the uncertainty of earlier stages and of
            given values; NaN if the estimates are not identifiable.
        fit: the fit with the nuisance parameters; c_b is the given value if the estimates are not identifiable.
        runs: the fitted runs.
    """

    bellows_damping: Estimate
    power_factor: Estimate
    correlation: Array
    inherited: tuple[float, float]
    fit: energy.EnergyFit
    runs: tuple[energy.PowerRun, ...]

    def clock_offset(self, name: str) -> float:
        """Return the clock offset of the power sensor in a run, s; NaN if unknown."""
        names = [run.recording.name for run in self.runs]
        return float(self.fit.clock_offset[names.index(name)]) if name in names else float("nan")


def identify_energy(
    runs: Sequence[energy.PowerRun],
    forces: Callable[[np.random.Generator], list[Array]],
    parameters: Parameters,
    random: np.random.Generator,
    hindrance: str = "",
) -> EnergyResult:
    """Estimate c_b and α_P from all runs.

    Args:
        runs: the runs.
        forces: function that draws the static forces (N) of all runs within their uncertainty. Each array has the
            times of `PowerRun.static_force`, continued to the end of the run.
        parameters: source of c_b if c_b is not identifiable, and of α_P if there are no runs.
        random: generator for the bootstrap.
        hindrance: reason why no interval of c_b and α_P would be valid; empty if there is no such reason.
    """
    note = hindrance or _why_not(runs)
    if note:
        return _given(runs, parameters, note)
    fit = energy.fit_energy(runs)
    weights = unit_weights(random, len(runs))
    seeds = random.integers(2**62, size=(weights.shape[0],)).tolist()
    start, alike = fit.solution, np.ones(len(runs))

    def refit(index: int) -> Array:
        """Return (c_b, α_P) with drawn weights, and with equal weights."""
        drawn = forces(np.random.default_rng(seeds[index]))
        moved = [
            replace(run, static_force=force[: run.time.size])  # up to the end of the traverse
            for run, force in zip(runs, drawn, strict=True)
        ]
        problem = energy.energy_problem(moved)
        samples = [energy.sample_weights(runs, weight) for weight in (weights[index], alike)]
        return np.array([solve(problem, start.shared, start.own, each).shared for each in samples])

    both = np.array([refit(index) for index in range(REFITS)])
    refits = both[:, 0]
    inherited = both[:, 1].var(axis=0) / refits.var(axis=0)
    damping, factor = estimates(np.array([fit.damping, fit.factor]), refits, len(runs))
    named = {"c_b": damping, "α_P": factor}
    vague = [name for name, e in named.items() if not e.spread <= VAGUE * e.value]  # also for NaN
    if vague:
        return _given(runs, parameters, NOT_SEPARATED.format(" and of ".join(vague)))
    shares = (min(float(inherited[0]), 1.0), min(float(inherited[1]), 1.0))
    return EnergyResult(damping, factor, correlation(refits), shares, fit, tuple(runs))


def _why_not(runs: Sequence[energy.PowerRun]) -> str:
    if not runs:
        return NO_POWER
    if len(runs) < FEWEST_RUNS:
        return "one run cannot separate c_b from α_P; record gaits of several frequencies"
    frequencies = {run.recording.gait.frequency for run in runs}
    lowest, highest = min(frequencies), max(frequencies)
    if highest < LEAST_FREQUENCY_RATIO * lowest:
        named = f"{lowest:g}" if lowest == highest else f"{lowest:g} to {highest:g}"
        return f"gaits of {named} Hz cannot separate c_b from α_P; record another frequency"
    return ""


def _given(runs: Sequence[energy.PowerRun], parameters: Parameters, note: str) -> EnergyResult:
    """Return a result with the given c_b and a fitted α_P (without runs: the given α_P), both not identifiable."""
    damping, nothing = parameters.bellows_damping, float("nan")
    fit = (
        energy.fit_energy(runs, damping=damping)
        if runs
        else energy.unseen_energy(damping, parameters.power_factor)
    )
    return EnergyResult(
        not_identifiable(damping, note),
        not_identifiable(fit.factor, f"{note}; fitted for the given c_b" if runs else note),
        np.full((2, 2), nothing),
        (nothing, nothing),
        fit,
        tuple(runs),
    )


@dataclass(frozen=True)
class Forces:
    """Forces F_c + c_b·L̇ = H + k_b(L_free − L) of each run at the times of its length; H as in `fits.energy`.

    Attributes:
        holding: H (N) by fit and run. The first fit is the best one. In each further fit, η or a combination of
            the fin parameters is one standard deviation away from its best value.
        initial_length: L0 of each run, m.
        change: ΔL of each run, m.
        stiffness, free_length: k_b (N/m) and L_free (m), each with its standard deviation.
    """

    holding: tuple[tuple[Array, ...], ...]
    initial_length: Array
    change: tuple[Array, ...]
    stiffness: tuple[float, float]
    free_length: tuple[float, float]

    @property
    def best(self) -> list[Array]:
        """Forces of each run for the best fit, N."""
        return self._forces(self.holding[0], self.stiffness[0], self.free_length[0])

    def draw(self, random: np.random.Generator) -> list[Array]:
        """Return the forces (N) of each run for a random draw of H, k_b and L_free within their uncertainty."""
        best, *others = self.holding
        size = random.standard_normal(len(others))
        holding = [
            held
            + sum((z * (other[run] - held) for z, other in zip(size, others, strict=True)), 0.0)
            for run, held in enumerate(best)
        ]
        stiffness, free_length = (
            value + deviation * random.standard_normal()
            for value, deviation in (self.stiffness, self.free_length)
        )
        return self._forces(holding, stiffness, free_length)

    def _forces(
        self, holding: Sequence[Array], stiffness: float, free_length: float
    ) -> list[Array]:
        return [
            force + stiffness * (free_length - initial - change)
            for force, initial, change in zip(
                holding, self.initial_length, self.change, strict=True
            )
        ]


def forces_of(
    traverses: Sequence[Traverse],
    rows: Sequence[int],
    locomotion: LocomotionResult,
    stiffness: Estimate,
    free_length: Estimate,
) -> Forces:
    """Return the forces of the runs with the indices ``rows`` of all ``traverses`` of the locomotion fit."""
    fits = (locomotion.fit, *locomotion.variants, locomotion.stiffer)
    return Forces(
        holding=tuple(holding_forces(traverses, rows, fit) for fit in fits),
        initial_length=locomotion.initial_length[list(rows)],
        change=tuple(traverses[row].length.length_change for row in rows),
        stiffness=(stiffness.value, np.nan_to_num(stiffness.spread) / quantile(np.inf)),
        free_length=(free_length.value, free_length.spread / quantile(np.inf)),
    )
