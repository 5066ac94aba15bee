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
from worm_model.identification.fits.energy import PowerRun, fit_energy
from worm_model.identification.fits.estimate import Estimate, not_identifiable, quantile
from worm_model.identification.fits.groove_scatter import groove_problem
from worm_model.identification.fits.locomotion import SHARED as LOCOMOTION
from worm_model.identification.fits.locomotion import Known
from worm_model.identification.fits.run_prediction import Errors, errors, predict
from worm_model.identification.idle import idle_power
from worm_model.identification.locomotion_stage import ONSET, LocomotionResult
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


def run_errors(run: FittedRun, parameters: Parameters, clock_offset: float) -> Errors:
    """Return the errors of one run. ``clock_offset`` (s) is positive if the camera's stamps are early."""
    prediction = predict(run.recording, run.traverse, parameters, clock_offset)
    return errors(run.recording, run.traverse, prediction)


def leave_one_out(
    runs: Sequence[FittedRun],
    known: Known,
    parameters: Parameters,
    locomotion: LocomotionResult,
    actuation: ActuationFit,
    power_runs: Sequence[PowerRun],
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
    by_name = {run.name: run for run in power_runs}
    fit = locomotion.fit
    traverses = [run.traverse for run in runs]
    problem = remembering(groove_problem(traverses, known, fit.places, fit.scatter), REMEMBERED)

    def left_out(index: int) -> tuple[Errors, Errors]:
        others = [k for k in range(len(runs)) if k != index]
        own = fit.solution.own[others]
        other_motion = solve(
            of_runs(problem, others), fit.solution.shared, own, iterations=ITERATIONS
        )
        other_actuation = fit_actuation([runs[k].recording for k in others])
        values = parameters.replace(
            **dict(zip(LOCOMOTION[:ONSET], other_motion.shared[:ONSET], strict=True)),
            **{key: getattr(other_actuation, key) for key in ACTUATION},
        )
        idle = idle_power([runs[k].idle for k in others])
        if idle is not None:
            values = values.replace(idle_power=idle.value)
        powered = [by_name[runs[k].name] for k in others if runs[k].name in by_name]
        if powered:
            fitted = fit_energy(powered, damping=damping)
            values = values.replace(bellows_damping=fitted.damping, power_factor=fitted.factor)
        offset = float(other_actuation.clock_offset.mean())
        return run_errors(runs[index], values, offset), run_errors(runs[index], PAPER, offset)

    held_out, paper = zip(*map(left_out, range(len(runs))), strict=True)
    names = [run.name for run in runs]
    return dict(zip(names, held_out, strict=True)), dict(zip(names, paper, strict=True))


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
