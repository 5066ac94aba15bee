# SPDX-License-Identifier: Apache-2.0
"""Comparison of the model with runs: leave-one-out errors, errors with the paper's table, and measured margins."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from worm_model.identification.data.observed_run import Recording
from worm_model.identification.energy_stage import EnergyResult
from worm_model.identification.fits.actuation_fit import KEYS as ACTUATION
from worm_model.identification.fits.actuation_fit import ActuationFit, fit_actuation
from worm_model.identification.fits.block_least_squares import of_runs, remembering, solve
from worm_model.identification.fits.energy import fit_energy
from worm_model.identification.fits.estimate import Estimate, not_identifiable, quantile
from worm_model.identification.fits.locomotion import SHARED as LOCOMOTION
from worm_model.identification.idle import idle_power
from worm_model.identification.locomotion_stage import ONSET, LocomotionResult
from worm_model.identification.run_prediction import Errors, run_errors
from worm_model.identification.run_selection import FittedRun
from worm_model.margin.half_cycles import Fin
from worm_model.margin.measured_margin import RunMargin, measure_cycles
from worm_model.margin.predicted_margin import predicted_margin
from worm_model.parameters import PAPER, Parameters
from worm_model.run import Run, TrackerSamples

ITERATIONS = 4  # iterations of the locomotion fit, which starts from the fit to all runs
# Number of residuals that are kept, so that those at the common start of the fits are computed once
REMEMBERED = 4096
FEWEST = 2  # smallest number of runs for leaving one out


def leave_one_out(
    runs: Sequence[FittedRun],
    parameters: Parameters,
    locomotion: LocomotionResult,
    actuation: ActuationFit,
    energy: EnergyResult,
) -> tuple[dict[str, Errors], dict[str, Errors]]:
    """Return the errors of each run with the parameters fitted to the other runs, and with the paper's table, by name.

    For each run, stages 4 to 7 (motion, actuation, idle power, energy) are repeated with the other runs. The fit of the
    motion starts from the fit to all runs. c_b is fixed if it is not identifiable. Some quantities are not estimated
    again:

    - The forces in the energy fit and the scatter of the grooves come from the fit to all runs.
    - L0 and the smoothed length of the left-out run come from that run itself.

    The clock offset of the camera in the left-out run is assumed to be the mean of the other runs, for both results.
    With a single run, the first result is empty, and the second uses the run's own offset.
    """
    if len(runs) < FEWEST:
        offset = float(actuation.clock_offset.mean())
        return {}, {run.name: run_errors(run, PAPER, offset) for run in runs}
    damping = None if energy.bellows_damping.identifiable else energy.fit.damping
    solution = locomotion.fit.solution
    problem = remembering(locomotion.fit.problem, REMEMBERED)
    held_out, paper = {}, {}
    for index, run in enumerate(runs):
        rows = [k for k in range(len(runs)) if k != index]
        others = [runs[k] for k in rows]
        motion = solve(
            of_runs(problem, rows), solution.shared, solution.own[rows], iterations=ITERATIONS
        )
        other_actuation = fit_actuation([other.recording for other in others])
        values = parameters.replace(
            **dict(zip(LOCOMOTION[:ONSET], motion.shared[:ONSET], strict=True)),
            **dict(zip(ACTUATION, other_actuation.values.tolist(), strict=True)),
        )
        idle = idle_power([other.idle for other in others])
        if idle is not None:
            values = values.replace(idle_power=idle.value)
        powered = [other for other in energy.runs if other.recording.name != run.name]
        if powered:
            fitted = fit_energy(powered, damping=damping)
            values = values.replace(bellows_damping=fitted.damping, power_factor=fitted.factor)
        offset = float(other_actuation.clock_offset.mean())
        held_out[run.name] = run_errors(run, values, offset)
        paper[run.name] = run_errors(run, PAPER, offset)
    return held_out, paper


NOT_MEASURED = "the tracker shows the switches of a fin in too few cycles"


def recorded_margin(recording: Recording, parameters: Parameters) -> RunMargin:
    """Return the measured margins of a recording."""
    stamps = np.rint(recording.camera_time * 1e9).astype(np.int64)
    run = Run(tracker=TrackerSamples(stamps, recording.x1, recording.x2))
    cycles = int(recording.end * recording.gait.frequency + 0.1)
    return measure_cycles(run, recording.gait, 0, cycles, parameters)


def margin_estimate(recording: Recording, parameters: Parameters) -> Estimate:
    """Return the smaller mean margin of both fins, m, with its 95 % interval."""
    least = recorded_margin(recording, parameters).least
    if least is None:
        return not_identifiable(np.nan, NOT_MEASURED)
    half = quantile(np.inf) * least.expected_sd
    return Estimate(least.expected, least.expected - half, least.expected + half)


def compared_margin(run: FittedRun, parameters: Parameters) -> tuple[float, float]:
    """Return the least measured margin of a run's cycles and the predicted one, m; NaN if a fin was not measured.

    The least one decides whether the run keeps its grooves, which is what a success probability states.
    """
    margin = recorded_margin(run.recording, parameters)
    if margin.keeps is None:
        return np.nan, np.nan
    least = min(float(margin.margins(fin)[0].min()) for fin in Fin)
    known = parameters.replace(initial_length=run.length.initial_length)
    return least, predicted_margin(run.recording.gait, known, margin.grooves)
