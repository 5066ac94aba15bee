# SPDX-License-Identifier: Apache-2.0
"""Verdict on the fit of the model to a robot, with the causes that the runs show."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from worm_model.arrays import Array
from worm_model.identification.actuation_stage import ActuationResult
from worm_model.identification.data.observed_run import Recording
from worm_model.identification.data.strides import uneven_pitch
from worm_model.identification.fits.actuation_fit import (
    CLOCK,
    START,
    actuation_problem,
    fitted_samples,
    slack_length,
)
from worm_model.identification.fits.block_least_squares import solve
from worm_model.identification.fits.estimate import noise_of
from worm_model.identification.locomotion_stage import LocomotionResult
from worm_model.identification.run_prediction import Errors
from worm_model.identification.run_selection import FittedRun

# Largest values of a model that fits: factor on the variances; held-out error of x1, in units of the camera's noise;
# relative held-out error of the energy
INFLATION, NOISES, ENERGY = 3.0, 2.0, 0.05
# Held-out error of x1, in pitches, above which the model does not fit
POOR = 0.05
LACKING = 1.5e-3  # m, lacking length in the extensions that a cable that can push does not show
DELAY_MS = 40.0  # largest usual offset of two clocks (95 % of the prior)
UNEVEN = 0.005  # relative standard deviation of the pitch of an uneven pipe
SCATTER = (
    3.5e-4,
    0.1,
)  # standard deviations between grooves, m of the threshold and relative of the stiffness


class Verdict(StrEnum):
    """How well the model describes the robot."""

    FITS = "fits"
    ROUGHLY = "roughly"
    DOES_NOT_FIT = "does_not_fit"


SENTENCES = {
    Verdict.FITS: "The model fits.",
    Verdict.ROUGHLY: "The model fits roughly: the intervals assume that it fits, and may miss the robot's values.",
    Verdict.DOES_NOT_FIT: "The model does not fit: do not rely on the intervals, nor on predictions near an edge.",
}


@dataclass(frozen=True)
class FitVerdict:
    """Verdict with the facts that it follows from; machine-readable output has the same names.

    Attributes:
        verdict: the verdict.
        causes: possible causes, each with what was measured.
        inflation: factor on the variances of stage 4, see `LocomotionResult`.
        groove_scatter_m: standard deviation of the threshold between grooves, m.
        x1_held_out_m, x1_paper_m: medians over the runs of the error of x1, m, with the parameters from the other runs
            and with the paper's table; NaN with one run.
    """

    verdict: Verdict
    causes: tuple[str, ...]
    inflation: float
    groove_scatter_m: float
    x1_held_out_m: float
    x1_paper_m: float

    @property
    def text(self) -> str:
        """The verdict as a paragraph, followed by a list of the causes."""
        x1 = "unknown, as it needs at least two runs"
        if np.isfinite(self.x1_held_out_m):
            x1 = (
                f"{1e3 * self.x1_held_out_m:.2f} mm (median of the runs; with the paper's table "
                f"{1e3 * self.x1_paper_m:.2f} mm)"
            )
        facts = (
            f"Held-out error of x1: {x1}. Residuals increase the variances by a factor of {self.inflation:.1f}. The "
            f"threshold varies by {1e3 * self.groove_scatter_m:.2f} mm from groove to groove."
        )
        return "\n".join([f"{SENTENCES[self.verdict]} {facts}", *(f"- {c}" for c in self.causes)])


def judge_fit(
    runs: Sequence[FittedRun],
    locomotion: LocomotionResult,
    actuation: ActuationResult,
    power_offset: Array,
    held_out: Mapping[str, Errors],
    paper: Mapping[str, Errors],
) -> FitVerdict:
    """Return the verdict on the fit of all runs.

    ``power_offset`` contains the clock offsets of the power sensor, in s (`EnergyFit.clock_offset`). ``held_out`` and
    ``paper`` are the errors of each run, see `held_out.leave_one_out`.
    """
    x1, x1_paper = (
        np.array([errors[run.name].x1_rmse for run in runs if run.name in held_out])
        for errors in (held_out, paper)
    )
    energy = np.array([abs(error.energy_error) for error in held_out.values()])
    noise = float(np.median([run.traverse.noise for run in runs]))
    unexplained = [run for run in runs if not run.length.explained]
    rough = bool(unexplained) or locomotion.inflation > INFLATION
    rough |= _median(x1) > NOISES * noise or _median(energy) > ENERGY
    worse = np.count_nonzero(~(x1 < x1_paper)) >= 0.5 * x1.size and _median(x1) > NOISES * noise
    poor = bool(locomotion.trouble) or _median(x1) > POOR * locomotion.pitch.value or worse
    verdict = Verdict.DOES_NOT_FIT if poor else Verdict.ROUGHLY if rough else Verdict.FITS
    causes = _of_length(runs, unexplained, actuation) + _of_power(power_offset)
    causes += _of_grooves(runs, locomotion)
    if worse:
        causes.append(
            f"in {np.count_nonzero(~(x1 < x1_paper))} of {x1.size} runs the other runs predict x1 no better than the "
            "paper's table: the runs differ from each other (other starts, another pipe), or the model lacks an effect"
        )
    return FitVerdict(
        verdict,
        (*([locomotion.trouble] if locomotion.trouble else []), *causes),
        locomotion.inflation,
        locomotion.fit.scatter.threshold,
        _median(x1),
        _median(x1_paper),
    )


def _of_length(
    runs: Sequence[FittedRun], unexplained: Sequence[FittedRun], actuation: ActuationResult
) -> list[str]:
    """Return causes that the measured length shows relative to the command."""
    causes, offset = [], actuation.fit.clock_offset
    if unexplained:
        offset, lacking = fit_contractions([run.recording for run in runs])
        worst = int(np.argmax(lacking))
        name, gait = runs[worst].name, runs[worst].recording.gait
        names = ", ".join(run.name for run in unexplained)
        causes.append(
            f"the cable cannot push: late in its extensions the body is {1e3 * lacking[worst]:.1f} mm shorter than "
            f"its contractions predict (median of {name}, {gait.frequency:g} Hz). The bellows are too slow for this "
            "gait, or something brakes them. δ_s, K, τ, c_b and α_P are averages over the gaits"
            if lacking[worst] > LACKING
            else f"the length does not follow slack, gain and time constant in {names}: the cable is compliant, or its "
            "slack is taken up slowly"
        )
    if abs(delay := 1e3 * float(np.median(-offset))) > DELAY_MS:
        causes.append(
            f"delay: the length follows the command {delay:+.0f} ms later than its time constant explains (fitted to "
            "100 ms at most). Check the servo's delay, and the stamps of camera and driver"
        )
    return causes


def _of_power(offset: Array) -> list[str]:
    """Return the delay between camera and power sensor as a cause, if it is long."""
    if not offset.size or abs(delay := 1e3 * float(np.median(offset))) <= DELAY_MS:
        return []
    return [
        f"delay: the camera's length follows the power by {delay:+.0f} ms (fitted up to 100 ms). Check the stamps "
        "of camera and power sensor; a compliant cable looks alike. The error is in c_b and α_P"
    ]


def _of_grooves(runs: Sequence[FittedRun], locomotion: LocomotionResult) -> list[str]:
    causes = []
    pitch = locomotion.pitch.value
    uneven = uneven_pitch([run.recording for run in runs], pitch) / pitch
    if uneven > UNEVEN:
        causes.append(
            f"the pitch is uneven: it varies by {100 * uneven:.1f} % from groove to groove"
        )
    scatter = locomotion.fit.scatter
    if scatter.threshold > SCATTER[0] or scatter.stiffness > SCATTER[1]:
        causes.append(
            f"the grooves differ: the threshold varies by {1e3 * scatter.threshold:.2f} mm and the fins' stiffness by "
            f"{100 * scatter.stiffness:.0f} % from groove to groove"
        )
    return causes


# Share of a contraction after which the cable is taut, and of an extension after which the bellows may lag behind
TAUT, LATE = 0.3, 0.5


def fit_contractions(recordings: Sequence[Recording]) -> tuple[Array, Array]:
    """Fit the actuation model to the rest and to the contractions of all recordings.

    A taut cable determines the length in a contraction. A cable that cannot push leaves the extension to the bellows,
    which lag behind in fast gaits. The contractions then follow the model, and the extensions end too short.

    Returns:
        The clock offset of each run in s (see `ActuationFit.clock_offset`), and the length in m that each run lacks:
        the median of predicted minus measured length in the second halves of the extensions, 0 without any.
    """
    phases = [_phases(recording) for recording in recordings]
    weights = [
        np.where((time < 0.0) | ((part > TAUT) & (part < 1.0)), 1.0, 0.0) for time, part in phases
    ]
    own = np.array([[slack_length(r), 0.0, 0.0] for r in recordings])
    problem = actuation_problem(recordings)
    solution = solve(problem, np.array(START), own, weights)
    late = [(time > 0.0) & (part > 1.0 + LATE) for time, part in phases]
    lacking = [
        -noise_of(recording.length) * float(np.median(residuals[rows])) if rows.any() else 0.0
        for recording, residuals, rows in zip(recordings, solution.residuals, late, strict=True)
    ]
    return solution.own[:, CLOCK], np.array(lacking)


def _phases(recording: Recording) -> tuple[Array, Array]:
    """Return the times (n,) in s of the fitted samples and their parts of the cycle (n,).

    The part is 0 to 1 during the contraction and 1 to 2 during the extension.
    """
    time = recording.camera_time[fitted_samples(recording)]
    gait, phase = recording.gait, np.mod(time * recording.gait.frequency, 1.0)
    share = gait.contraction_share
    part: Array = np.where(phase < share, phase / share, 1.0 + (phase - share) / (1.0 - share))
    return time, part


def _median(values: Array) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if known.size else float("nan")
