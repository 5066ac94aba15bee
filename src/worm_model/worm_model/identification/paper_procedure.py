# SPDX-License-Identifier: Apache-2.0
"""The paper's procedure, for comparison: least squares of J_loc, J_act and J_E as printed, without nuisance parameters.

All instruments share one clock, L0 is the measured length at rest, the pitch is as given, all grooves are equal, there
is no dry friction, all samples have equal weight, and there are no intervals. J_loc is discontinuous where a groove is
gained or lost. It is therefore evaluated on a grid first. The paper does not state how J_loc was minimised.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares, minimize

from worm_model.arrays import Array, accumulated
from worm_model.errors import IdentificationError
from worm_model.identification.bellows import fit_bellows
from worm_model.identification.data.observed_run import Recording
from worm_model.identification.fin import KEYS as FIN
from worm_model.identification.fin import fit_fin
from worm_model.identification.fits.actuation_fit import KEYS as ACTUATION
from worm_model.identification.fits.actuation_fit import START, predicted_length_change
from worm_model.identification.fits.locomotion import (
    MOST_THRESHOLD,
    RIDGES,
    SEARCHED_FRICTION,
    least_threshold,
)
from worm_model.identification.idle import SAMPLES
from worm_model.identification.inputs import Inputs
from worm_model.parameters import NOT_OF_PAPER, Parameters
from worm_model.simulation.kernel.work import cable_power
from worm_model.simulation.simulator import Locomotion, SimulationError
from worm_model.simulation.smoothing import smooth

THRESHOLD_STEP = 2.5e-4  # m, step of p_sw on the grid
REFINED = 3  # number of best grid points that are refined by a simplex search
PRETENSION = (
    "{}: the gait has a pretension, but the paper's procedure assumes a slack cable at rest; "
    "omit --literal or exclude this run"
)
LOST = 1.0  # m², J_loc if the anchors switch endlessly in a run


@dataclass(frozen=True)
class _Traverse:
    """Part of a run until x1 has advanced by five pitches.

    Attributes:
        recording: the run.
        time: times of the camera samples after the onset in which both markers are visible, s, shape (n,).
        x1: position of the rear module, m, shape (n,).
        change: ΔL, m, shape (n,).
        initial_length: L0, m.
    """

    recording: Recording
    time: Array
    x1: Array
    change: Array
    initial_length: float


def literal(
    inputs: Inputs,
    known: Parameters,
    progress: Callable[[str, float], None] = lambda *_: None,
    fin_engages: int = 0,
) -> tuple[Parameters, dict[str, float]]:
    """Minimise the paper's costs with the paper's power model.

    The bench tests determine the stiffnesses and the clearance. All parameters that neither the recordings nor the
    bench tests determine have the values of ``known``. ``fin_engages`` is the sign of the displacement that engages in
    the fin test, −1 or +1; 0 detects it.

    Returns:
        The parameters, and the minimal costs: J_loc and J_act in m², J_E in J².
    """
    for recording in inputs.recordings:
        if recording.gait.pretension > 0.0:
            raise IdentificationError(PRETENSION.format(recording.name))
    paper = known.replace(**dict.fromkeys(NOT_OF_PAPER, 0.0), one_sided_cable=False)
    p = _with_bench(inputs, paper, fin_engages)
    runs = [_traverse(recording, p.pitch) for recording in inputs.recordings]
    p = p.replace(initial_length=float(np.mean([run.initial_length for run in runs])))
    (friction, threshold), j_loc = _locomotion(runs, p, lambda done: progress("J_loc", done))
    p = p.replace(viscous_friction=friction, switching_threshold=threshold)
    actuation, j_act = _actuation(runs)
    p = p.replace(**dict(zip(ACTUATION, actuation, strict=True)))
    powered = [run for run in runs if run.recording.power_time.size >= SAMPLES]
    if not powered:
        raise IdentificationError(f"no run has the {SAMPLES} power samples that J_E requires")
    idle = float(np.mean([run.recording.power[:SAMPLES].mean() for run in powered]))
    (damping, factor), j_e = _energy(powered, p)
    progress("J_E", 1.0)
    p = p.replace(idle_power=idle, bellows_damping=damping, power_factor=factor)
    return p, {"J_loc": j_loc, "J_act": j_act, "J_E": j_e}


def _with_bench(inputs: Inputs, p: Parameters, fin_engages: int) -> Parameters:
    if inputs.bellows is not None:
        p = p.replace(
            bellows_stiffness=fit_bellows(inputs.bellows.x, inputs.bellows.y).stiffness.value
        )
    if inputs.fin is not None:
        fin = fit_fin(inputs.fin.x, inputs.fin.y, fin_engages)
        p = p.replace(**{key: getattr(fin, key).value for key in FIN})
    return p


def _traverse(recording: Recording, pitch: float) -> _Traverse:
    known = np.isfinite(recording.length)
    length = float(np.mean(recording.length[recording.at_rest]))
    advance = recording.gait.direction * recording.x1
    arrived = np.flatnonzero(known & (advance >= RIDGES * pitch))
    end = recording.camera_time[arrived[0]] if arrived.size else recording.end
    kept = known & (recording.camera_time > 0.0) & (recording.camera_time <= end)
    return _Traverse(
        recording,
        recording.camera_time[kept],
        recording.x1[kept],
        recording.length[kept] - length,
        length,
    )


def _model(run: _Traverse, p: Parameters) -> Locomotion:
    return Locomotion(p.replace(initial_length=run.initial_length), run.recording.gait.direction)


def _locomotion(
    runs: Sequence[_Traverse], p: Parameters, progress: Callable[[float], None]
) -> tuple[Array, float]:
    """Return (η, p_sw) and J_loc (eq:locomotion_identification_cost)."""
    samples = sum(run.time.size for run in runs)

    def cost(values: Array) -> float:
        friction, threshold = max(values[0], 1.0), max(values[1], least_threshold(p))
        tried = p.replace(viscous_friction=friction, switching_threshold=threshold)
        total = 0.0
        for run in runs:
            model = _model(run, tried)
            try:
                _, motions = model.follow(model.start(), run.time, run.change)
            except SimulationError:
                return LOST
            total += float(np.sum((run.x1 - motions.x1) ** 2))
        return total / samples

    thresholds = np.arange(least_threshold(p), MOST_THRESHOLD * p.pitch, THRESHOLD_STEP)
    grid = []
    for row, friction in enumerate(SEARCHED_FRICTION, 1):
        points = (np.array([friction, threshold]) for threshold in thresholds)
        grid += [(cost(point), *point) for point in points]
        progress(row / SEARCHED_FRICTION.size)
    fits = [
        minimize(
            cost,
            point,
            method="Nelder-Mead",
            options={
                "initial_simplex": [
                    point,
                    point * [1.1, 1.0],
                    point + [0.0, 0.5 * THRESHOLD_STEP],
                ],
                "xatol": 1e-6,
                "fatol": 1e-14,
            },
        )
        for point in (np.array(best[1:]) for best in sorted(grid)[:REFINED])
    ]
    best = min(fits, key=lambda solution: solution.fun)
    return best.x, float(best.fun)


def _actuation(runs: Sequence[_Traverse]) -> tuple[Array, float]:
    """Return (δ_s, K, τ) and J_act (eq:actuation_identification_cost)."""

    def residuals(values: Array) -> Array:
        return np.concatenate(
            [run.change - predicted_length_change(run.recording, values, run.time) for run in runs]
        )

    fit = least_squares(
        residuals, START, x_scale=[1e-3, 0.1, 0.1], bounds=([0.0, 0.01, 1e-3], [0.1, 10.0, 10.0])
    )
    return fit.x, float(np.mean(fit.fun**2))


def _energy(runs: Sequence[_Traverse], p: Parameters) -> tuple[Array, float]:
    """Return (c_b, α_P) and J_E (eq:energy_identification_cost), with the idle power of each run."""
    tables = [_power_table(run, p.replace(bellows_damping=0.0)) for run in runs]

    def residuals(values: Array) -> Array:
        damping, factor = values
        parts = []
        for time, rate, force, power, idle in tables:
            predicted = idle + factor * cable_power(force - damping * rate, rate, False)
            left = accumulated(time, power) - accumulated(time, predicted)
            parts.append(left / np.sqrt(left.size * len(tables)))
        return np.concatenate(parts)

    start = [p.bellows_damping, p.power_factor]
    fit = least_squares(residuals, start, x_scale=[100.0, 1.0], bounds=([0.0, 0.01], np.inf))
    return fit.x, float(np.sum(fit.fun**2))


def _power_table(run: _Traverse, p: Parameters) -> tuple[Array, Array, Array, Array, float]:
    """Return the power samples of a run and the quantities from which their prediction follows.

    Returns:
        Time (s), L̇ of the smoothed length (m/s), F_c without damping (N) and power (W) at the power samples, and the
        idle power (W).
    """
    recording = run.recording
    length = smooth(np.concatenate([[0.0], run.time]), np.concatenate([[0.0], run.change]))
    known = np.isfinite(length.value) & np.isfinite(length.rate)
    length = type(length)(length.time[known], length.value[known], length.rate[known])
    first, last = length.time[0], length.time[-1]
    inside = (recording.power_time >= first) & (recording.power_time <= last)
    time = recording.power_time[inside]
    model = _model(run, p)
    breaks, coefficients = length.cubic()
    start = model.start(float(first), float(length.value[0]))
    _, motions = model.follow_polynomial(start, breaks, coefficients, time)
    idle = float(recording.power[:SAMPLES].mean())
    return time, motions.length_rate, motions.cable_force, recording.power[inside], idle
