# SPDX-License-Identifier: Apache-2.0
"""All stages in the order of the paper's Section V, and what is left over when they are held against each run."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from worm_model.identification.actuation import fit_actuation
from worm_model.identification.actuation_stage import ActuationResult, identify_actuation
from worm_model.identification.bellows import BellowsFit, fit_bellows
from worm_model.identification.energy import PowerRun, fit_energy, power_run
from worm_model.identification.energy_stage import EnergyResult, identify_energy
from worm_model.identification.estimate import Estimate, quantile
from worm_model.identification.fin import FinFit, fit_fin
from worm_model.identification.forces import Forces, forces_of
from worm_model.identification.given import Given
from worm_model.identification.idle import IdlePower, idle_power, idle_power_of
from worm_model.identification.inputs import Inputs
from worm_model.identification.locomotion import Traverse, traverse_of
from worm_model.identification.locomotion_stage import (
    FinKnowledge,
    LocomotionResult,
    identify_locomotion,
    refit,
)
from worm_model.identification.measured_length import MeasuredLength, measured_length
from worm_model.identification.prediction import Errors, errors, predict
from worm_model.identification.quality import remarks, usable
from worm_model.identification.recording import Recording
from worm_model.parameters import KEYS, PAPER, Parameters

Array = NDArray[np.float64]
Progress = Callable[[str, float], None]

HELD_OUT_ITERATIONS = 4
FIN = ("clearance", "engaged_stiffness", "disengaged_stiffness")
NO_FIN = "x1 tells but its ratio to the fins' stiffness, fitted under the given one; add a fin test"
UNDER_GIVEN_FINS = "fitted under the given fins; add a fin test"
NO_BELLOWS = "no bellows test, and c_b and α_P depend on k_b"
FEWEST_HELD_OUT = 2  # runs, of which one can be left out


@dataclass(frozen=True)
class Run:
    """A run that was used: its recording, smoothed length, five ridges and idle power."""

    recording: Recording
    length: MeasuredLength
    traverse: Traverse
    idle: IdlePower

    @property
    def name(self) -> str:
        """The run's name."""
        return self.recording.name


@dataclass(frozen=True)
class Identification:
    """Everything that came out.

    ``estimates`` of all keys and the ``parameters`` that they make; the results of the stages; ``held_out``: errors
    of each run under what the others say (empty with one run); ``paper``: under the paper's table; ``validation``: of
    further runs under ``parameters``; ``warnings`` in words.
    """

    estimates: Mapping[str, Estimate]
    parameters: Parameters
    given: Given
    runs: tuple[Run, ...]
    bellows: BellowsFit | None
    fin: FinFit | None
    locomotion: LocomotionResult
    actuation: ActuationResult
    energy: EnergyResult
    power_runs: tuple[PowerRun, ...]
    held_out: Mapping[str, Errors]
    paper: Mapping[str, Errors]
    validation: Mapping[str, Errors]
    warnings: tuple[str, ...]
    seed: int


def identify(
    inputs: Inputs,
    given: Given,
    seed: int = 0,
    fin_engages: int = 0,
    validation: Sequence[Recording] = (),
    progress: Progress = lambda _stage, _done: None,
) -> Identification:
    """All parameters from recordings and bench tests; the same inputs and ``seed`` give the same numbers.

    Raises `worm_model.identification.errors.IdentificationError` if the data do not suffice.
    """
    random = np.random.default_rng(seed)
    estimates = {key: given.estimate(key) for key in KEYS}
    bellows = fit_bellows(inputs.bellows.x, inputs.bellows.y) if inputs.bellows else None
    fin = fit_fin(inputs.fin.x, inputs.fin.y, fin_engages) if inputs.fin else None
    estimates |= _bench_estimates(bellows, fin)
    runs, warnings = _prepared(inputs.recordings, given.parameters.pitch)
    checked, _ = _prepared(validation, given.parameters.pitch) if validation else ([], [])
    estimates["initial_length"] = _initial_length(runs)
    parameters = _with_values(given.parameters, estimates)
    known = _fin_knowledge(estimates, fin)
    locomotion = identify_locomotion(
        [run.traverse for run in runs],
        parameters,
        known,
        lambda done: progress("locomotion", done),
    )
    estimates |= _locomotion_estimates(locomotion, known)
    progress("actuation", 0.0)
    actuation = identify_actuation([run.recording for run in runs], random)
    estimates["slack"], estimates["gain"] = actuation.slack, actuation.gain
    estimates["time_constant"] = actuation.time_constant
    estimates["idle_power"] = idle_power([run.idle for run in runs])
    progress("energy", 0.0)
    energy, power_runs = _energy(runs, parameters, estimates, locomotion, given, random)
    estimates["bellows_damping"] = energy.bellows_damping
    estimates["power_factor"] = energy.power_factor
    parameters = _with_values(parameters, estimates)
    progress("held out", 0.0)
    offset = float(actuation.fit.clock_offset.mean())
    result = Identification(
        estimates=estimates,
        parameters=parameters,
        given=given,
        runs=tuple(runs),
        bellows=bellows,
        fin=fin,
        locomotion=locomotion,
        actuation=actuation,
        energy=energy,
        power_runs=tuple(power_runs),
        held_out=_held_out(runs, parameters, locomotion, power_runs),
        paper={run.name: _errors(run, PAPER) for run in runs},
        validation={run.name: _errors(run, parameters, offset) for run in checked},
        warnings=tuple(warnings),
        seed=seed,
    )
    progress("done", 1.0)
    return result


def _energy(
    runs: Sequence[Run],
    parameters: Parameters,
    estimates: Mapping[str, Estimate],
    locomotion: LocomotionResult,
    given: Given,
    random: np.random.Generator,
) -> tuple[EnergyResult, list[PowerRun]]:
    """Stage 7, on the forces that stage 4 left."""
    stiffness = estimates["bellows_stiffness"]
    forces = forces_of([run.traverse for run in runs], parameters, locomotion, stiffness, given)
    power_runs = _power_runs(runs, forces, estimates["idle_power"].value)
    result = identify_energy(
        power_runs,
        [run.recording.gait.frequency for run in runs],
        forces.draw,
        given.parameters.bellows_damping,
        random,
        "" if stiffness.identifiable else NO_BELLOWS,
    )
    return result, power_runs


def _bench_estimates(bellows: BellowsFit | None, fin: FinFit | None) -> dict[str, Estimate]:
    found = {}
    if bellows is not None:
        found["bellows_stiffness"] = bellows.stiffness
    if fin is not None:
        found["clearance"] = fin.clearance
        found["engaged_stiffness"] = fin.engaged_stiffness
        found["disengaged_stiffness"] = fin.disengaged_stiffness
    return found


def _fin_knowledge(estimates: Mapping[str, Estimate], fin: FinFit | None) -> FinKnowledge | None:
    """By the fin test, else by the bounds that were given, None if there are none."""
    if fin is not None:
        return FinKnowledge(fin.values, fin.covariance)
    given = [estimates[key] for key in FIN]
    if not all(estimate.identifiable for estimate in given):
        return None
    deviation = np.array([estimate.spread / quantile(np.inf) for estimate in given])
    return FinKnowledge(np.array([e.value for e in given]), np.diag(deviation**2))


def _locomotion_estimates(
    locomotion: LocomotionResult, known: FinKnowledge | None
) -> dict[str, Estimate]:
    """Without a fin test x1 tells but the ratio of η to the fins' stiffness."""
    friction, threshold = locomotion.viscous_friction, locomotion.switching_threshold
    if known is None:
        nothing = float("nan")
        friction = Estimate(friction.value, nothing, nothing, False, NO_FIN)
        threshold = Estimate(threshold.value, nothing, nothing, False, UNDER_GIVEN_FINS)
    return {"viscous_friction": friction, "switching_threshold": threshold}


def _prepared(recordings: Sequence[Recording], pitch: float) -> tuple[list[Run], list[str]]:
    """The runs that can be used, and what was seen in all of them."""
    lengths = [measured_length(recording) for recording in recordings]
    kept, warnings = usable(recordings, lengths)
    runs = []
    for index in kept:
        recording, length = recordings[index], lengths[index]
        run = Run(
            recording, length, traverse_of(recording, length, pitch), idle_power_of(recording)
        )
        warnings += remarks(recording, length, run.traverse)
        warnings += [run.idle.warning] if run.idle.warning else []
        runs.append(run)
    return runs, warnings


def _initial_length(runs: Sequence[Run]) -> Estimate:
    """The mean over runs: a robot is not put into its pipe twice in the same way."""
    lengths = np.array([run.length.initial_length for run in runs])
    mean = float(lengths.mean())
    if lengths.size > 1:
        half = quantile(lengths.size - 1) * float(lengths.std(ddof=1) / np.sqrt(lengths.size))
    else:
        half = quantile(np.inf) * runs[0].length.initial_spread
    return Estimate(mean, mean - half, mean + half)


def _with_values(parameters: Parameters, estimates: Mapping[str, Estimate]) -> Parameters:
    return parameters.replace(**{key: estimate.value for key, estimate in estimates.items()})


def _power_runs(runs: Sequence[Run], forces: Forces, idle: float) -> list[PowerRun]:
    """With each run's own idle power where it has one."""
    return [
        power_run(
            run.recording,
            run.length.time,
            run.length.rate,
            force,
            run.traverse.end,
            run.idle.value if np.isfinite(run.idle.value) else idle,
        )
        for run, force in zip(runs, forces.best, strict=True)
    ]


def _errors(run: Run, parameters: Parameters, clock_offset: float = 0.0) -> Errors:
    prediction = predict(run.recording, run.traverse, parameters, clock_offset)
    return errors(run.recording, run.traverse, prediction)


def _held_out(
    runs: Sequence[Run],
    parameters: Parameters,
    locomotion: LocomotionResult,
    power_runs: Sequence[PowerRun],
) -> dict[str, Errors]:
    """Errors of each run under parameters that the other runs gave."""
    if len(runs) < FEWEST_HELD_OUT:
        return {}

    def left_out(index: int) -> Errors:
        others = [k for k in range(len(runs)) if k != index]
        fit = refit(
            [runs[k].traverse for k in others],
            parameters,
            locomotion.fit,
            locomotion.fit.solution.own[others],
            HELD_OUT_ITERATIONS,
        )
        actuation = fit_actuation([runs[k].recording for k in others])
        energy = fit_energy([power_runs[k] for k in others])
        values = parameters.replace(
            viscous_friction=fit.means[0],
            switching_threshold=fit.means[1],
            slack=actuation.slack,
            gain=actuation.gain,
            time_constant=actuation.time_constant,
            idle_power=idle_power([runs[k].idle for k in others]).value,
            bellows_damping=energy.damping,
            power_factor=energy.factor,
        )
        return _errors(runs[index], values, float(actuation.clock_offset.mean()))

    with ThreadPoolExecutor() as pool:
        found = list(pool.map(left_out, range(len(runs))))
    return {run.name: error for run, error in zip(runs, found, strict=True)}
