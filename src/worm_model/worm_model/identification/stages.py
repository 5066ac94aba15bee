# SPDX-License-Identifier: Apache-2.0
"""Identification with all stages of the paper's Section V, and held-out errors."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from worm_model.errors import IdentificationError
from worm_model.identification.actuation_stage import ActuationResult, identify_actuation
from worm_model.identification.bellows import BellowsFit, fit_bellows
from worm_model.identification.data.observed_run import Recording
from worm_model.identification.data.strides import check_pitch
from worm_model.identification.energy_stage import EnergyResult, Forces, forces_of, identify_energy
from worm_model.identification.fin import KEYS as FIN
from worm_model.identification.fin import FinFit, fit_fin
from worm_model.identification.fit_verdict import FitVerdict, judge_fit
from worm_model.identification.fits.actuation_fit import KEYS as ACTUATION
from worm_model.identification.fits.energy import PowerRun, power_run
from worm_model.identification.fits.estimate import Estimate, admissible, not_identifiable, quantile
from worm_model.identification.fits.locomotion import Known
from worm_model.identification.fits.run_prediction import Errors
from worm_model.identification.held_out import compared_margin, leave_one_out, run_errors
from worm_model.identification.idle import NO_IDLE, idle_power
from worm_model.identification.inputs import Inputs
from worm_model.identification.locomotion_stage import (
    UNEXPLAINED,
    FinKnowledge,
    LocomotionResult,
    identify_locomotion,
)
from worm_model.identification.reference_values import ReferenceValues
from worm_model.identification.run_selection import (
    FittedRun,
    fitted_runs,
    initial_length,
    prepared_validation,
)
from worm_model.parameters import FITTED_WITH_FORM, KEYS, Parameters
from worm_model.travel_error import travel_error
from worm_msgs.robot_parameters import TravelError

Progress = Callable[[str, float], None]

NO_FIN = "x1 determines only the ratio of friction to fin stiffness; fitted for the given stiffness; add a fin test"
UNDER_GIVEN_FINS = "fitted for the given fins; add a fin test"
NOT_OF_PAPER = "not in the paper's model; without it η would be {:.1f} N·s/m"
NO_BELLOWS = "no bellows test, and c_b and α_P depend on k_b"
ONE_SIDED = "for a cable that cannot push, not comparable with the paper's value"
OTHER_FORM = (
    "--one-sided-cable is not applied: these runs do not determine c_b and α_P ({}), and the given values were fitted "
    "with the paper's power model"
)
NOT_USED = "{}; the test is not used"
NO_FRICTION = "η is not identified, and c_b and α_P depend on it"
SOFT_FIN = (
    "fin test: the side that --fin-engages names is the softer one ({engaged:.0f} against {disengaged:.0f} N/m), but "
    "an anchoring fin is stiffer; check the sign"
)


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
        power_runs: data of the runs whose power samples cover the traverse, for the energy model.
        held_out: errors of each run with the parameters fitted to the other runs; empty with one run.
        paper: errors of each run with the parameters of the paper's table.
        validation: errors of the validation runs with ``parameters``.
        margins: measured and predicted margin (m) of each run, NaN where it was not measured.
        warnings: remarks on data and results.
        seed: seed of the bootstrap.
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
    power_runs: tuple[PowerRun, ...]
    held_out: Mapping[str, Errors]
    paper: Mapping[str, Errors]
    validation: Mapping[str, Errors]
    margins: Mapping[str, tuple[float, float]]
    warnings: tuple[str, ...]
    seed: int

    @property
    def travel_error(self) -> TravelError | None:
        """Measured minus predicted margin, None if no run shows its margin."""
        measured, predicted = np.array(list(self.margins.values())).T
        return travel_error(measured, predicted) if np.isfinite(measured).any() else None

    def power_clock(self, name: str) -> tuple[float, float]:
        """Return the clock offset of the power sensor in a run, and the standard deviation of the offset, s.

        The offset is positive if the sensor's stamps are early relative to those of the camera. Unknown values are NaN.
        """
        for run, offset, deviation in zip(
            self.power_runs,
            self.energy.fit.clock_offset,
            self.energy.clock_deviation,
            strict=True,
        ):
            if run.name == name:
                return float(offset), float(deviation)
        return float("nan"), float("nan")


def identify(
    inputs: Inputs,
    reference: ReferenceValues,
    seed: int = 0,
    fin_engages: int = 0,
    validation: Sequence[Recording] = (),
    progress: Progress = lambda _stage, _done: None,
) -> Identification:
    """Identify all parameters from recordings and bench tests.

    After a failure of a stage, the estimates that depend on it are not identifiable, and all others are valid.
    Equal inputs and seeds produce equal results. c_b and α_P are fitted with the power model that the parameters of
    ``reference`` select; if the runs do not determine them and the given values belong to the other model, with that.

    Args:
        inputs: recordings and bench tests.
        reference: given values, with their uncertainty.
        seed: seed of the bootstrap.
        fin_engages: sign of the displacement that engages in the fin test, −1 or +1; 0 detects it.
        validation: runs that are not fitted, but only predicted with the identified parameters.
        progress: called with the name of a step and its completed share, 0 to 1.

    Raises:
        IdentificationError: No run is usable, or the strides contradict the given pitch.
    """
    random = np.random.default_rng(seed)
    estimates = {key: reference.estimate(key) for key in KEYS}
    bellows, fin, failed = _bench_tests(inputs, fin_engages)
    estimates |= _bench_estimates(bellows, fin)
    runs, warnings = fitted_runs(inputs.recordings, reference.parameters.pitch)
    checked, observed = prepared_validation(
        validation, inputs.recordings, reference.parameters.pitch
    )
    estimates["initial_length"] = initial_length(runs)
    idle = idle_power([run.idle for run in runs])
    estimates["idle_power"] = idle or not_identifiable(reference.parameters.idle_power, NO_IDLE)
    pitch_deviation = estimates["pitch"].spread / quantile(np.inf)
    check_pitch([run.recording for run in runs], reference.parameters.pitch, pitch_deviation)
    known = Known(_with_values(reference.parameters, estimates), pitch_deviation)
    locomotion = identify_locomotion(
        [run.traverse for run in runs],
        known,
        _fin_knowledge(estimates, fin),
        lambda done: progress("locomotion", done),
    )
    estimates |= _locomotion_estimates(locomotion, estimates, fin)
    progress("actuation", 0.0)
    actuation = identify_actuation([run.recording for run in runs], random)
    estimates |= {key: getattr(actuation, key) for key in ACTUATION}
    progress("energy", 0.0)
    energy, power_runs = _energy(runs, known.parameters, estimates, locomotion, reference, random)
    if reference.fitted_otherwise and not energy.power_factor.identifiable:
        failed.append(OTHER_FORM.format(energy.power_factor.note))
        reference = reference.with_papers_cable()
        known = replace(known, parameters=known.parameters.replace(one_sided_cable=False))
        energy, power_runs = _energy(
            runs, known.parameters, estimates, locomotion, reference, random
        )
    estimates |= _energy_estimates(energy, reference)
    estimates = {key: admissible(key, estimate) for key, estimate in estimates.items()}
    parameters = _with_values(known.parameters, estimates)
    progress("held out", 0.0)
    held_out, paper = leave_one_out(
        runs, known, parameters, locomotion, actuation.fit, power_runs, energy
    )
    offset = float(actuation.fit.clock_offset.mean())
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
        power_runs=tuple(power_runs),
        held_out=held_out,
        paper=paper,
        validation={run.name: run_errors(run, parameters, offset) for run in checked},
        margins={run.name: compared_margin(run, parameters) for run in runs},
        warnings=(*inputs.remarks, *failed, *bench_warnings(fin), *warnings, *observed),
        seed=seed,
    )
    progress("done", 1.0)
    return result


def _bench_tests(
    inputs: Inputs, fin_engages: int
) -> tuple[BellowsFit | None, FinFit | None, list[str]]:
    """Return the fits of the bench tests, None without a usable test, and the reasons why a test cannot be used."""
    bellows, fin, failed = None, None, []
    try:
        if inputs.bellows:
            bellows = fit_bellows(inputs.bellows.x, inputs.bellows.y)
    except IdentificationError as error:
        failed.append(NOT_USED.format(error))
    try:
        if inputs.fin:
            fin = fit_fin(inputs.fin.x, inputs.fin.y, fin_engages)
    except IdentificationError as error:
        failed.append(NOT_USED.format(error))
    return bellows, fin, failed


def _energy(
    runs: Sequence[FittedRun],
    parameters: Parameters,
    estimates: Mapping[str, Estimate],
    locomotion: LocomotionResult,
    reference: ReferenceValues,
    random: np.random.Generator,
) -> tuple[EnergyResult, list[PowerRun]]:
    """Run stage 7 with the forces of stage 4, for the runs whose power samples cover the traverse."""
    frequencies = [run.recording.gait.frequency for run in runs if run.has_power]
    if locomotion.trouble == UNEXPLAINED:  # no force of the fins is known
        return identify_energy([], [], lambda _: [], reference.parameters, random, NO_FRICTION), []
    powered = [index for index, run in enumerate(runs) if run.has_power]
    stiffness = estimates["bellows_stiffness"]
    forces = forces_of(
        [run.traverse for run in runs], parameters, locomotion, stiffness, reference
    ).of(powered)
    power_runs = _power_runs(
        [runs[index] for index in powered],
        forces,
        parameters.replace(idle_power=estimates["idle_power"].value),
    )
    hindrance = "" if locomotion.viscous_friction.identifiable else NO_FRICTION
    result = identify_energy(
        power_runs,
        frequencies,
        forces.draw,
        reference.parameters,
        random,
        hindrance if stiffness.identifiable else NO_BELLOWS,
    )
    return result, power_runs


def bench_warnings(fin: FinFit | None) -> list[str]:
    """Return warnings about the bench tests."""
    if fin is None or fin.engaged_stiffness.value >= fin.disengaged_stiffness.value:
        return []
    return [
        SOFT_FIN.format(
            engaged=fin.engaged_stiffness.value, disengaged=fin.disengaged_stiffness.value
        )
    ]


def _bench_estimates(bellows: BellowsFit | None, fin: FinFit | None) -> dict[str, Estimate]:
    estimates = {}
    if bellows is not None:
        estimates["bellows_stiffness"] = bellows.stiffness
    return estimates | ({key: getattr(fin, key) for key in FIN} if fin is not None else {})


def _fin_knowledge(estimates: Mapping[str, Estimate], fin: FinFit | None) -> FinKnowledge | None:
    """Return the fin parameters and their covariance from the fin test, or without a test from the given bounds.

    The result is None if there is no test and a fin parameter has no given bounds.
    """
    if fin is not None:
        return FinKnowledge(fin.values, fin.covariance)
    known = [estimates[key] for key in FIN]
    if not all(estimate.identifiable for estimate in known):
        return None
    deviation = np.array([estimate.spread / quantile(np.inf) for estimate in known])
    return FinKnowledge(np.array([e.value for e in known]), np.diag(deviation**2))


def _locomotion_estimates(
    locomotion: LocomotionResult, estimates: Mapping[str, Estimate], fin: FinFit | None
) -> dict[str, Estimate]:
    """Return the estimates of stage 4.

    If there is neither a fin test nor given bounds of the fin parameters, x1 determines only the ratio of friction to
    fin stiffness. The friction and the threshold are then not identifiable.
    """
    friction, threshold = locomotion.viscous_friction, locomotion.switching_threshold
    note = NOT_OF_PAPER.format(locomotion.without_dry_friction[0])
    dry = [replace(estimate, note=estimate.note or note) for estimate in locomotion.dry_friction]
    if _fin_knowledge(estimates, fin) is None:
        friction = not_identifiable(friction.value, NO_FIN)
        threshold = not_identifiable(threshold.value, UNDER_GIVEN_FINS)
        dry = [not_identifiable(estimate.value, NO_FIN) for estimate in dry]
    pitch_estimate = estimates["pitch"]
    value, spread = 1e3 * pitch_estimate.value, 1e3 * pitch_estimate.spread
    note = f"from x1 over the ridges; {value:.2f} ± {spread:.2f} mm {pitch_estimate.note}"
    pitch = locomotion.pitch
    return {
        "viscous_friction": friction,
        "switching_threshold": threshold,
        "rear_dry_friction": dry[0],
        "front_dry_friction": dry[1],
        "pitch": Estimate(pitch.value, pitch.low, pitch.high, pitch.identifiable, note),
    }


def _energy_estimates(energy: EnergyResult, reference: ReferenceValues) -> dict[str, Estimate]:
    """Return c_b and α_P."""
    fitted = dict(zip(FITTED_WITH_FORM, (energy.bellows_damping, energy.power_factor), strict=True))
    if not reference.parameters.one_sided_cable:
        return fitted
    return {
        key: replace(estimate, note="; ".join(filter(None, (estimate.note, ONE_SIDED))))
        for key, estimate in fitted.items()
    }


def _with_values(parameters: Parameters, estimates: Mapping[str, Estimate]) -> Parameters:
    return parameters.replace(**{key: estimate.value for key, estimate in estimates.items()})


def _power_runs(runs: Sequence[FittedRun], forces: Forces, known: Parameters) -> list[PowerRun]:
    """Return the data of the runs for the energy model, with each run's own idle power if it is known."""
    return [
        power_run(
            run.recording,
            run.length.time,
            run.length.rate,
            force,
            run.traverse.end,
            run.idle.value if np.isfinite(run.idle.value) else known.idle_power,
            one_sided_cable=known.one_sided_cable,
        )
        for run, force in zip(runs, forces.best, strict=True)
    ]
