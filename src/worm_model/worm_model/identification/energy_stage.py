# SPDX-License-Identifier: Apache-2.0
"""Stage 7 as a whole: c_b and α_P with intervals from a bootstrap over runs.

In every refit the runs are weighted anew, and what earlier stages and the ruler left open is drawn: k_b, L_free, and
the locomotion fit with its friction and fins. One gait frequency cannot tell c_b from α_P (their effects are
proportional), and is reported so.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from worm_model.arrays import Array
from worm_model.identification.block_least_squares import clock_deviations, evaluate, told
from worm_model.identification.energy import (
    CLOCK_SPREAD,
    INDEPENDENT,
    EnergyFit,
    PowerRun,
    energy_problem,
    fit_energy,
    predicted_energy,
    unseen_energy,
)
from worm_model.identification.estimate import VAGUE, Estimate, not_told
from worm_model.identification.resampling import correlation, estimates, refitted, unit_weights
from worm_model.parameters import Parameters

LEAST_FREQUENCY_RATIO = 1.4  # of the fastest to the slowest gait
FEWEST_RUNS = 2
LEAST_SCATTER = 1e-6  # J
NO_POWER = (
    "no run has power samples over its five ridges: let the power sensor log until the run ends"
)


@dataclass(frozen=True)
class EnergyResult:
    """``bellows_damping`` N·s/m and ``power_factor``; ``fit`` has the nuisances.

    ``correlation`` (2, 2) of the two; ``inherited``: which part of their variances comes from what earlier stages and
    the ruler left open. Without ``identifiable`` estimates, ``fit`` holds c_b at the given value.
    ``clock_deviation`` (runs,) s, of the fit's clock offsets, NaN where the data tell none.
    """

    bellows_damping: Estimate
    power_factor: Estimate
    correlation: Array
    inherited: tuple[float, float]
    fit: EnergyFit
    clock_deviation: Array


def identify_energy(
    runs: Sequence[PowerRun],
    frequencies: Sequence[float],
    forces: Callable[[np.random.Generator], list[Array]],
    parameters: Parameters,
    random: np.random.Generator,
    hindrance: str = "",
) -> EnergyResult:
    """Both parameters of all runs.

    ``forces`` draws the static forces (n,) in N of every run; ``frequencies`` in Hz are those of the runs;
    ``parameters`` have c_b, and α_P where no run was seen;
    ``hindrance`` says why no interval would be honest, if so.
    """
    note = hindrance or _why_not(runs, frequencies)
    if note:
        return _given(runs, parameters, note)
    fit = fit_energy(runs)
    weights = unit_weights(random, len(runs))
    seeds = random.integers(2**62, size=(weights.shape[0],)).tolist()

    def refit(index: int, weight: Array) -> Array:
        drawn = forces(np.random.default_rng(seeds[index]))
        moved = [
            replace(run, static_force=force[: run.time.size])  # on to where the run was left
            for run, force in zip(runs, drawn, strict=True)
        ]
        solution = fit_energy(moved, weight, fit)
        return np.array([solution.damping, solution.factor])

    refits = refitted(lambda index: refit(index, weights[index]))
    alike = np.ones(len(runs))
    inherited = refitted(lambda index: refit(index, alike)).var(axis=0) / refits.var(axis=0)
    damping, factor = estimates(np.array([fit.damping, fit.factor]), refits, len(runs))
    identifiable = [e.spread <= VAGUE * e.value for e in (damping, factor)]  # False of NaN too
    if not all(identifiable):
        return _given(runs, parameters, "the runs leave it open by more than half its value")
    shares = (min(float(inherited[0]), 1.0), min(float(inherited[1]), 1.0))
    return EnergyResult(damping, factor, correlation(refits), shares, fit, _clocks(runs, fit))


def _why_not(runs: Sequence[PowerRun], frequencies: Sequence[float]) -> str:
    if not runs:
        return NO_POWER
    if len(runs) < FEWEST_RUNS:
        return "one run cannot tell c_b from α_P; record gaits of several frequencies"
    if max(frequencies) < LEAST_FREQUENCY_RATIO * min(frequencies):
        frequency_range = " to ".join(
            f"{f:g}" for f in sorted({min(frequencies), max(frequencies)})
        )
        return f"gaits of {frequency_range} Hz cannot tell c_b from α_P; record another frequency"
    return ""


def _given(runs: Sequence[PowerRun], parameters: Parameters, note: str) -> EnergyResult:
    """c_b stays as given; the factor that goes with it is fitted, if it can be, but is no more certain than c_b is."""
    damping, nothing = parameters.bellows_damping, float("nan")
    fit = (
        fit_energy(runs, damping=damping)
        if runs
        else unseen_energy(damping, parameters.power_factor)
    )
    return EnergyResult(
        not_told(damping, note),
        not_told(fit.factor, f"{note}; fitted under the given c_b" if runs else note),
        np.full((2, 2), nothing),
        (nothing, nothing),
        fit,
        _clocks(runs, fit),
    )


def _clocks(runs: Sequence[PowerRun], fit: EnergyFit) -> Array:
    """By what is left over in each run, and by how far its idle power, held in the fit, may be off."""
    if not runs:
        return np.empty(0)
    scatter = np.maximum([np.sqrt(np.mean(r**2)) for r in fit.residuals], LEAST_SCATTER)
    weights = [
        np.full(run.power_time.size, INDEPENDENT / run.power_time.size / own**2)
        for run, own in zip(runs, scatter, strict=True)
    ]
    problem = energy_problem(runs, scale=1.0)
    solution = evaluate(problem, fit.solution.shared, fit.solution.own)
    idle = np.array([run.idle for run in runs])
    idle_deviation = float(idle.std(ddof=1)) if idle.size > 1 else 0.0
    by_idle = [
        _shift_by_idle(run, fit, offset) for run, offset in zip(runs, fit.clock_offset, strict=True)
    ]
    return told(
        np.hypot(
            clock_deviations(problem, solution, 0, weights), idle_deviation * np.array(by_idle)
        ),
        CLOCK_SPREAD,
    )


def _shift_by_idle(run: PowerRun, fit: EnergyFit, offset: float) -> float:
    """By how many s a fitted offset moves for a watt of idle power too much: a ramp of energy looks like a shift."""
    sides = [
        predicted_energy(run, fit.damping, fit.factor, offset + half) for half in (-5e-4, 5e-4)
    ]
    by_offset = (sides[1] - sides[0]) / 1e-3
    ramp = run.power_time - run.power_time[0]
    return abs(float(by_offset @ ramp)) / max(float(by_offset @ by_offset), 1e-12)
