# SPDX-License-Identifier: Apache-2.0
"""Recommendation of the next run: the gait that would shrink the widest interval most.

For each candidate gait, the exact model computes a run until the robot has passed five ridges. The Fisher information
of this run about the parameters, with the run's nuisance parameters marginalised, is added to the present information.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import product

import numpy as np

from worm_model.arrays import Array
from worm_model.gait import Gait
from worm_model.identification.actuation_stage import ActuationResult
from worm_model.identification.data.observed_run import Recording
from worm_model.identification.energy_stage import EnergyResult
from worm_model.identification.fits.actuation_fit import KEYS as ACTUATION
from worm_model.identification.fits.actuation_fit import actuation_problem, camera_noise
from worm_model.identification.fits.block_least_squares import Problem, evaluate, normal_equations
from worm_model.identification.fits.energy import INDEPENDENT, PowerRun, energy_problem
from worm_model.identification.fits.energy import KEYS as ENERGY
from worm_model.identification.fits.estimate import Estimate, quantile
from worm_model.identification.fits.groove_scatter import groove_problem
from worm_model.identification.fits.locomotion import RIDGES, Known, first_own, traverse_of
from worm_model.identification.fits.measured_length import measured_length
from worm_model.identification.locomotion_stage import LocomotionResult
from worm_model.identification.stages import Identification
from worm_model.parameters import PAPER
from worm_model.simulation.simulator import simulate

STROKES = (0.05, 0.07, 0.09)  # m
FREQUENCIES = (0.08, 0.12, 0.2, 0.3, 0.4)  # Hz
MOST_CYCLES = 12  # a gait that needs more cycles for five ridges is no candidate
CAMERA_RATE, COMMAND_RATE, POWER_RATE = 30.0, 100.0, 50.0  # Hz
REST = 2.0  # s, before the onset
STAGES = {
    "locomotion": ("viscous_friction", "switching_threshold"),
    "actuation": ACTUATION,
    "energy": ENERGY,
}
# Measurements that shrink the intervals of parameters for which no candidate gait is evaluated
MEASUREMENTS = {
    "bellows_stiffness": "repeat the bellows test with four times the points",
    "clearance": "repeat the fin test with four times the points near its knees",
    "engaged_stiffness": "repeat the fin test with four times the points on its engaging side",
    "disengaged_stiffness": "repeat the fin test with four times the points on its sliding side",
    "idle_power": "record more runs without pretension, at rest before the gait",
}


def advise(result: Identification) -> str:
    """Return a sentence with the widest interval, relative to its value, and the measurement that would shrink it most.

    If an estimate of `STAGES` is not identifiable, the sentence states the note of the first such estimate instead.
    """
    sought = [key for keys in STAGES.values() for key in keys]
    vague = [key for key in sought if not result.estimates[key].identifiable]
    if vague:
        return f"{vague[0]}: {result.estimates[vague[0]].note}"
    width = {
        key: _relative_spread(result.estimates[key], key)
        for key in (*MEASUREMENTS, *sought)
        if result.estimates[key].identifiable
    }
    key = max(width, key=lambda k: width[k])
    head = f"the widest interval is that of {key} (±{100 * width[key]:.1f} %)"
    if key in MEASUREMENTS:
        return f"{head}; {MEASUREMENTS[key]}"
    stage = next(name for name, keys in STAGES.items() if key in keys)
    best = _best_gait(result, stage, key)
    if best is None:
        return f"{head}; none of the candidate gaits passes {RIDGES} ridges"
    gait, shrunk = best
    text = f"{head}; of {len(STROKES) * len(FREQUENCIES)} candidate gaits, one more run at {gait.stroke:g} m and "
    text += f"{gait.frequency:g} Hz would shrink it most, to {100 * shrunk:.0f} % of its width"
    if stage == "locomotion" and _limited_by_grooves(result, key):
        text += (
            "; differences between grooves limit it: start at other ridges, or pass more of them"
        )
    if _inherited(result, key) > 0.5:
        text += "; most of the interval is due to given values and bench tests: measure them more accurately"
    return text


def _relative_spread(estimate: Estimate, key: str) -> float:
    """Return the half-width relative to the value, or to a tenth of the paper's value if the tenth is larger."""
    return estimate.spread / max(abs(estimate.value), 0.1 * getattr(PAPER, key))


def _inherited(result: Identification, key: str) -> float:
    """Return the share of the variance that is due to earlier stages and given values, at most 0.98.

    Further runs do not reduce this part of the variance.
    """
    if key in STAGES["energy"]:
        share = result.energy.inherited[STAGES["energy"].index(key)]
    elif key in STAGES["locomotion"]:
        entry, fit = STAGES["locomotion"].index(key), result.locomotion.fit
        off = [v.means[entry] - fit.means[entry] for v in result.locomotion.variants]
        share = (
            float(np.sum(np.square(off))) / (result.estimates[key].spread / quantile(np.inf)) ** 2
        )
    else:
        share = 0.0
    return min(share, 0.98)


def _limited_by_grooves(result: Identification, key: str) -> bool:
    scatter = result.locomotion.fit.scatter
    if key == "viscous_friction":
        return scatter.stiffness > 0.01
    return scatter.threshold > 5e-5


def _best_gait(result: Identification, stage: str, key: str) -> tuple[Gait, float] | None:
    """Return the best gait, and the ratio of the interval's width after and before a run with this gait.

    The result is None if no candidate gait passes the ridges.
    """
    keys = STAGES[stage]
    entry = keys.index(key)
    inherited = _inherited(result, key)
    covariance = (1.0 - inherited) * _covariance(result, stage)
    candidates = []
    for stroke, frequency in product(STROKES, FREQUENCIES):
        recording = recorded(Gait(stroke, frequency), result)
        if recording is None:
            continue
        information = _information(result, stage, recording)
        # The covariance of few runs may be singular and is therefore not inverted.
        gain = np.eye(len(keys)) + information @ covariance
        posterior = covariance @ np.linalg.inv(gain)
        own = posterior[entry, entry] / covariance[entry, entry]
        shrunk = float(np.sqrt(inherited + (1.0 - inherited) * own))
        candidates.append((shrunk, stroke, frequency))
    if not candidates:
        return None
    shrunk, stroke, frequency = min(candidates)
    return Gait(stroke, frequency), shrunk


def _covariance(result: Identification, stage: str) -> Array:
    keys = STAGES[stage]
    deviation = np.array([result.estimates[key].spread / quantile(np.inf) for key in keys])
    stage_result: LocomotionResult | ActuationResult | EnergyResult = getattr(result, stage)
    correlation = stage_result.correlation[: len(keys), : len(keys)]
    return correlation * np.outer(deviation, deviation)


def recorded(gait: Gait, result: Identification) -> Recording | None:
    """Return the noise-free recording of a gait until the robot has passed five ridges, or None if it never does."""
    parameters = result.parameters
    trajectory = simulate(gait, parameters, MOST_CYCLES)
    camera = np.arange(0.0, trajectory.duration, 1.0 / CAMERA_RATE)
    motion = trajectory.at(camera)
    arrived = np.flatnonzero(motion.x1 >= RIDGES * parameters.pitch)
    if not arrived.size:
        return None
    end = int(arrived[0]) + 1
    rest = np.arange(-REST, 0.0, 1.0 / CAMERA_RATE)
    command = np.arange(0.0, camera[end - 1] + 0.5, 1.0 / COMMAND_RATE)
    power = np.arange(0.0, camera[end - 1], 1.0 / POWER_RATE)
    return Recording(
        name="planned",
        gait=gait,
        camera_time=np.concatenate([rest, camera[:end]]),
        x1=np.concatenate([0.0 * rest, motion.x1[:end]]),
        x2=np.concatenate([0.0 * rest + parameters.initial_length, motion.x2[:end]]),
        command_time=command,
        command=np.array([gait.command(time) for time in command]),
        power_time=power,
        power=trajectory.at(power).power,
    )


def _information(result: Identification, stage: str, recording: Recording) -> Array:
    """Return the information matrix (k, k) of the stage's parameters, in inverse squared units."""
    if stage == "actuation":
        residuals = result.actuation.fit.solution.residuals
        noises = [camera_noise(run.recording) for run in result.runs]
        noise = float(np.median([n * np.std(r) for n, r in zip(noises, residuals, strict=True)]))
        problem = actuation_problem([recording], noise)
        own = np.array([[result.parameters.initial_length, 0.0, 0.0]])
        return _marginal(problem, result.actuation.fit.values, own, 3)
    if stage == "energy":
        return _energy_information(result, recording)
    length = replace(
        measured_length(recording), initial_spread=result.runs[0].length.initial_spread
    )
    noise = float(np.median([run.traverse.noise for run in result.runs]))
    traverse = replace(traverse_of(recording, length, result.parameters.pitch), noise=noise)
    fit = result.locomotion.fit
    deviation = result.reference.estimate("pitch").spread / quantile(np.inf)
    known = Known(result.parameters, deviation)
    problem = groove_problem([traverse], known, fit.places, fit.scatter)
    own = first_own([traverse])
    return _marginal(problem, fit.solution.shared, own, 2) / result.locomotion.inflation


def _energy_information(result: Identification, recording: Recording) -> Array:
    parameters = result.parameters
    motion = simulate(recording.gait, parameters, MOST_CYCLES).at(recording.power_time)
    static = motion.cable_force + parameters.bellows_damping * motion.length_rate
    run = PowerRun(
        recording,
        recording.power_time,
        motion.length_rate,
        static,
        recording.power_time,
        recording.power,
        parameters.idle_power,
        parameters.one_sided_cable,
    )
    values = np.array([parameters.bellows_damping, parameters.power_factor])
    scatter = float(np.sqrt(np.mean(result.energy.fit.scatter**2)))
    problem = energy_problem([run], scatter)
    weights = [np.full(recording.power_time.size, INDEPENDENT / recording.power_time.size)]
    return _marginal(problem, values, np.zeros((1, 1)), 2, weights)


def _marginal(
    problem: Problem,
    shared: Array,
    own: Array,
    count: int,
    weights: Sequence[Array] | None = None,
) -> Array:
    """Return the information on the first ``count`` shared parameters, with all others marginalised."""
    matrix, _ = normal_equations(problem, evaluate(problem, shared, own), weights)
    cross = matrix[:count, count:]
    information: Array = (
        matrix[:count, :count]
        - cross @ np.linalg.pinv(matrix[count:, count:], hermitian=True) @ cross.T
    )
    return information
