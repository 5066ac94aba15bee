# SPDX-License-Identifier: Apache-2.0
"""Identification with all stages of the paper's Section V, and held-out errors."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from worm_model.arrays import Array
from worm_model.errors import IdentificationError
from worm_model.identification.actuation_stage import ActuationResult, identify_actuation
from worm_model.identification.bellows import BellowsFit, fit_bellows
from worm_model.identification.data.strides import check_pitch
from worm_model.identification.energy_stage import EnergyResult, forces_of, identify_energy
from worm_model.identification.fin import KEYS as FIN
from worm_model.identification.fin import FinFit, fit_fin
from worm_model.identification.fit_verdict import FitVerdict, judge_fit
from worm_model.identification.fits.actuation_fit import KEYS as ACTUATION
from worm_model.identification.fits.energy import power_run
from worm_model.identification.fits.estimate import Estimate, admissible, not_identifiable, quantile
from worm_model.identification.fits.locomotion import Known
from worm_model.identification.fits.resampling import SEED
from worm_model.identification.held_out import compared_margin, leave_one_out
from worm_model.identification.idle import NO_IDLE, idle_power
from worm_model.identification.inputs import BenchTest, Inputs
from worm_model.identification.locomotion_stage import (
    UNEXPLAINED,
    LocomotionResult,
    identify_locomotion,
)
from worm_model.identification.reference_values import ReferenceValues
from worm_model.identification.run_prediction import Errors
from worm_model.identification.run_selection import FittedRun, fitted_runs, initial_length
from worm_model.parameters import FITTED_WITH_FORM, KEYS, Parameters
from worm_model.travel_error import travel_error
from worm_msgs.robot_parameters import TravelError

Progress = Callable[[str, float], None]
_Fit = TypeVar("_Fit")

NO_FIN = "x1 determines only the ratio of friction to fin stiffness; fitted for the given stiffness; add a fin test"
UNDER_GIVEN_FINS = "fitted for the given fins; add a fin test"
NOT_OF_PAPER = "not in the paper's model; without it η would be {:.1f} N·s/m"
NO_BELLOWS = "no bellows test, and c_b and α_P depend on k_b"
ONE_SIDED = "for a cable that cannot push, not comparable with the paper's value"
OTHER_FORM = (
    "--one-sided-cable is not applied: these runs do not determine c_b and α_P ({}), and the given values were fitted "
    "with the paper's power model"
)
NO_FRICTION = "η is not identified, and c_b and α_P depend on it"


@dataclass(frozen=True)
class Identification:
    """Result of an identification.

    Attributes:
        fit: verdict on the fit.
        estimates: estimates of all keys.
        parameters: the resulting parameters.
        reference: the reference values given to `identify`.
        runs: runs that were used.
        bellows, fin: fits of the bench tests, None if the test is missing.
        locomotion, actuation, energy: results of the stages.
        held_out: errors of each run with the parameters fitted to the other runs; empty with one run.
        paper: errors of each run with the parameters of the paper's table.
        margins: measured and predicted margin (m) of each run, NaN where it was not measured.
        warnings: remarks on data and results.
    """

    fit: FitVerdict
    estimates: Mapping[str, Estimate]
    parameters: Parameters
    reference: ReferenceValues
    runs: tuple[FittedRun, ...]
    bellows: BellowsFit | None
    fin: FinFit | None
    locomotion: LocomotionResult
    actuation: ActuationResult
    energy: EnergyResult
    held_out: Mapping[str, Errors]
    paper: Mapping[str, Errors]
    margins: Mapping[str, tuple[float, float]]
    warnings: tuple[str, ...]

    @property
    def travel_error(self) -> TravelError | None:
        """Measured minus predicted margin, None if no run shows its margin."""
        measured, predicted = np.array(list(self.margins.values())).T
        return travel_error(measured, predicted) if np.isfinite(measured).any() else None


def identify(
    inputs: Inputs,
    reference: ReferenceValues,
    progress: Progress = lambda _stage, _done: None,
) -> Identification:
    """Identify all parameters from recordings and bench tests.

    After a failure of a stage, the estimates that depend on it are not identifiable, and all others are valid. Equal
    inputs produce equal results.

    Args:
        inputs: recordings and bench tests.
        reference: given values, with their uncertainty. They select the power model, with which c_b and α_P are fitted.
        progress: called with the name of a step and its completed share, 0 to 1.

    Raises:
        IdentificationError: No run is usable, the strides contradict the given pitch, or the runs do not determine c_b
            and α_P, and their given values belong to the other power model.
    """
    random = np.random.default_rng(SEED)
    failed: list[str] = []
    bellows = _fit_bench_test(fit_bellows, inputs.bellows, failed)
    fin = _fit_bench_test(fit_fin, inputs.fin, failed)
    runs, warnings = fitted_runs(inputs.recordings, reference.parameters.pitch)
    idle = idle_power([run.idle for run in runs])
    estimates = {key: reference.estimate(key) for key in KEYS}
    estimates |= {} if bellows is None else {"bellows_stiffness": bellows.stiffness}
    estimates |= {} if fin is None else {key: getattr(fin, key) for key in FIN}
    estimates |= {
        "initial_length": initial_length(runs),
        "idle_power": idle or not_identifiable(reference.parameters.idle_power, NO_IDLE),
    }
    pitch_deviation = estimates["pitch"].spread / quantile(np.inf)
    check_pitch([run.recording for run in runs], reference.parameters.pitch, pitch_deviation)
    known = Known(_with_values(reference.parameters, estimates), pitch_deviation)
    fin_covariance = _given_covariance(estimates) if fin is None else fin.covariance
    locomotion = identify_locomotion(
        [run.traverse for run in runs],
        known,
        fin_covariance,
        lambda done: progress("locomotion", done),
    )
    estimates |= _locomotion_estimates(locomotion, estimates["pitch"], fin_covariance)
    progress("actuation", 0.0)
    actuation = identify_actuation([run.recording for run in runs], random)
    estimates |= {key: getattr(actuation, key) for key in ACTUATION}
    progress("energy", 0.0)
    energy = _identify_energy(runs, estimates, locomotion, reference, random)
    if reference.fitted_otherwise and not energy.power_factor.identifiable:
        failed.append(OTHER_FORM.format(energy.power_factor.note))
        papers = reference.parameters.replace(one_sided_cable=False)
        reference = replace(reference, parameters=papers, fitted_otherwise=False)
        known = replace(known, parameters=known.parameters.replace(one_sided_cable=False))
        energy = _identify_energy(runs, estimates, locomotion, reference, random)
    estimates |= _energy_estimates(energy, reference)
    estimates = {key: admissible(key, estimate) for key, estimate in estimates.items()}
    parameters = _with_values(known.parameters, estimates)
    progress("held out", 0.0)
    held_out, paper = leave_one_out(runs, parameters, locomotion, actuation.fit, energy)
    result = Identification(
        fit=judge_fit(runs, locomotion, actuation, energy.fit.clock_offset, held_out, paper),
        estimates=estimates,
        parameters=parameters,
        reference=reference,
        runs=tuple(runs),
        bellows=bellows,
        fin=fin,
        locomotion=locomotion,
        actuation=actuation,
        energy=energy,
        held_out=held_out,
        paper=paper,
        margins={run.name: compared_margin(run, parameters) for run in runs},
        warnings=(*inputs.remarks, *failed, *warnings),
    )
    progress("done", 1.0)
    return result


def _fit_bench_test(
    fit: Callable[[Array, Array], _Fit], test: BenchTest | None, failed: list[str]
) -> _Fit | None:
    """Return the fit of a bench test, None without a usable test; ``failed`` gets the reason why it cannot be used."""
    try:
        return fit(test.x, test.y) if test else None
    except IdentificationError as error:
        failed.append(f"{error}; the test is not used")
        return None


def _given_covariance(estimates: Mapping[str, Estimate]) -> Array | None:
    """Return the covariance of the fin parameters from their given bounds, None if one of them has no bounds."""
    fins = [estimates[key] for key in FIN]
    if not all(estimate.identifiable for estimate in fins):
        return None
    return np.diag([(estimate.spread / quantile(np.inf)) ** 2 for estimate in fins])


def _locomotion_estimates(
    locomotion: LocomotionResult, given_pitch: Estimate, fin_covariance: Array | None
) -> dict[str, Estimate]:
    """Return the estimates of stage 4.

    If there is neither a fin test nor given bounds of the fin parameters, x1 determines only the ratio of friction to
    fin stiffness. The friction and the threshold are then not identifiable.
    """
    note = NOT_OF_PAPER.format(locomotion.without_dry_friction[0])
    estimates = {
        "viscous_friction": locomotion.viscous_friction,
        "switching_threshold": locomotion.switching_threshold,
    }
    dry = {key: getattr(locomotion, key) for key in ("rear_dry_friction", "front_dry_friction")}
    estimates |= {key: replace(each, note=each.note or note) for key, each in dry.items()}
    if fin_covariance is None:
        notes = dict.fromkeys(estimates, NO_FIN) | {"switching_threshold": UNDER_GIVEN_FINS}
        estimates = {k: not_identifiable(e.value, notes[k]) for k, e in estimates.items()}
    value, spread = 1e3 * given_pitch.value, 1e3 * given_pitch.spread
    note = f"from x1 over the ridges; {value:.2f} ± {spread:.2f} mm {given_pitch.note}"
    return estimates | {"pitch": replace(locomotion.pitch, note=note)}


def _identify_energy(
    runs: Sequence[FittedRun],
    estimates: Mapping[str, Estimate],
    locomotion: LocomotionResult,
    reference: ReferenceValues,
    random: np.random.Generator,
) -> EnergyResult:
    """Run stage 7 with the forces of stage 4, for the runs whose power samples cover the traverse."""
    explained = locomotion.trouble != UNEXPLAINED  # otherwise no force of the fins is known
    powered = [index for index, run in enumerate(runs) if run.has_power and explained]
    stiffness = estimates["bellows_stiffness"]
    traverses = [run.traverse for run in runs]
    free_length = reference.estimate("unstressed_length")
    forces = forces_of(traverses, powered, locomotion, stiffness, free_length)
    usual_idle = estimates["idle_power"].value
    power_runs = [
        power_run(
            runs[index].recording,
            runs[index].length.time,
            runs[index].length.rate,
            force,
            runs[index].traverse.end,
            runs[index].idle.value if np.isfinite(runs[index].idle.value) else usual_idle,
            one_sided_cable=reference.parameters.one_sided_cable,
        )
        for index, force in zip(powered, forces.best, strict=True)
    ]
    hindrance = "" if locomotion.viscous_friction.identifiable else NO_FRICTION
    if not stiffness.identifiable:
        hindrance = NO_BELLOWS
    return identify_energy(power_runs, forces.draw, reference.parameters, random, hindrance)


def _energy_estimates(energy: EnergyResult, reference: ReferenceValues) -> dict[str, Estimate]:
    """Return c_b and α_P."""
    form = ONE_SIDED if reference.parameters.one_sided_cable else ""
    fitted = {key: getattr(energy, key) for key in FITTED_WITH_FORM}
    return {
        key: replace(estimate, note="; ".join(filter(None, (estimate.note, form))))
        for key, estimate in fitted.items()
    }


def _with_values(parameters: Parameters, estimates: Mapping[str, Estimate]) -> Parameters:
    return parameters.replace(**{key: estimate.value for key, estimate in estimates.items()})
