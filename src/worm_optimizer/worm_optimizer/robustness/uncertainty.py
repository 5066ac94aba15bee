# SPDX-License-Identifier: Apache-2.0
"""Scenarios: draws of the parameters from their uncertainty, with known or unknown groove phase."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from worm_model.parameters import KEYS, POWER_ONLY, ParameterFile, Parameters
from worm_model.simulation.closed_form import deflected_share, front_groove, groove_phase
from worm_model.travel_error import PRIOR
from worm_msgs.robot_parameters import ROWS
from worm_optimizer.evaluation.task import Array

# 95 % half-widths relative to the value, for parameters of the motion without an interval in the parameter file. They
# are estimates of this project, not of the paper: the accuracy of scales, a caliper, a force gauge and a camera.
MOTION_HALF_WIDTHS: Mapping[str, float] = {
    "rear_mass": 0.01,
    "front_mass": 0.01,
    "pitch": 0.005,
    "viscous_friction": 0.20,
    "engaged_stiffness": 0.10,
    "disengaged_stiffness": 0.10,
    "switching_threshold": 0.03,
    "clearance": 0.05,
    "time_constant": 0.10,
    "gain": 0.02,
    "slack": 0.05,
}
# The same for parameters that affect only the power. A fit determines the product of bellows damping and power factor
# better than either factor. The uncertainty of the power therefore depends on the correlation of both in the file.
POWER_HALF_WIDTHS: Mapping[str, float] = {
    "bellows_stiffness": 0.03,
    "bellows_damping": 0.10,
    "idle_power": 0.05,
    "power_factor": 0.05,
}
LENGTH = "initial_length"  # is not drawn itself, but follows from the drawn pitch and groove phase
TRAVEL = "travel_error"  # is drawn, and subtracted from the drawn switching threshold
# All parameters that are drawn. Those without a half-width above vary only if the file has an interval or a scatter.
MOTION_KEYS = (
    *MOTION_HALF_WIDTHS,
    *(k for k in KEYS if k not in {*MOTION_HALF_WIDTHS, *POWER_ONLY, LENGTH}),
    TRAVEL,
)
POWER_KEYS = (*POWER_HALF_WIDTHS, *(k for k in KEYS if k in POWER_ONLY - {*POWER_HALF_WIDTHS}))

_PHASES = 64  # number of phases of `every_phase`
# Numbers of the streams of random numbers for the first parameter of MOTION_KEYS and of POWER_KEYS. The stream of each
# further parameter has the next number.
_MOTION_STREAM, _POWER_STREAM = 10, 1000
_NORMAL_95 = 1.959963984540054  # half-width of the central 95 % of a normal distribution, standard deviations
# Largest deviation of a draw, in standard deviations, so that draws stay admissible
_MOST_DEVIATIONS = 4.0


@dataclass(frozen=True)
class Scenarios:
    """Equally likely parameter sets. ``overrides`` contains arrays of parameter values, shape (n,), by key."""

    overrides: Mapping[str, Array]

    def __len__(self) -> int:
        return len(self.overrides["initial_length"])


def reach_of(content: ParameterFile, key: str) -> tuple[float, float]:
    """Return the 95 % reach of a parameter: how far its interval extends below and above its value, in its unit.

    If the file contains no interval, both are the default half-width, or 0 without a default. The scatter from run to
    run is added in quadrature. The reach of the travel error is that of the file, or of `PRIOR`.
    """
    if key == TRAVEL:
        travel = _NORMAL_95 * (content.travel_error or PRIOR).sd
        return travel, travel
    width = MOTION_HALF_WIDTHS.get(key, POWER_HALF_WIDTHS.get(key, 0.0))
    value = content.parameters.as_dict()[key]
    low, high = content.intervals.get(key, (value * (1.0 - width), value * (1.0 + width)))
    scatter = _NORMAL_95 * content.run_to_run.get(key, 0.0)
    return math.hypot(max(value - low, 0.0), scatter), math.hypot(max(high - value, 0.0), scatter)


def description(content: ParameterFile) -> str:
    """Return the source of the uncertainty of a parameter file as text."""
    reach = max(reach_of(content, LENGTH))
    phase = f"; φ known to ±{1e3 * reach:.2f} mm in the next run" if reach > 0.0 else ""
    return f"{_parameters_described(content)}{phase}; {travel_described(content)}"


def travel_described(content: ParameterFile) -> str:
    """Return the condition on the travel error under which all printed probabilities hold, as text."""
    reach, _ = reach_of(content, TRAVEL)
    if content.travel_error is None:
        return (
            f"if the model is right to ±{1e3 * reach:.1f} mm of travel, which no run has measured"
        )
    return f"measured travel error {1e3 * content.travel_error.value:+.1f} ± {1e3 * reach:.1f} mm"


def _parameters_described(content: ParameterFile) -> str:
    own = [key for key in MOTION_KEYS if key in content.intervals]
    if all(key in own for key, width in MOTION_HALF_WIDTHS.items() if width > 0.0):
        return "the parameter file's 95 % intervals"
    others = ", ".join(
        f"{key} ±{100.0 * width:g} %"
        for key, width in MOTION_HALF_WIDTHS.items()
        if key not in content.intervals and width > 0.0
    )
    mine = f"the parameter file's 95 % intervals of {', '.join(own)}; " if own else ""
    return f"{mine}assumed at 95 %: {others}"


def phase_known(content: ParameterFile, samples: int, seed: int) -> Scenarios:
    """Return draws of the parameters near the file's groove phase φ.

    The reach of the drawn phase is that of the initial length in the next run (interval of the mean, and scatter from
    run to run). Drawing the length instead would add 17 times the error of the pitch to the phase, because
    φ = L0 − n·d with n = 17 for the paper's robot. Deviations are normal, with a separate width on each side.
    """
    overrides = _draws(content, MOTION_KEYS, samples, seed, _MOTION_STREAM)
    trim = _offset(_deviates(samples, seed, stream=1), reach_of(content, LENGTH))
    phase = groove_phase(content.parameters) + trim
    return Scenarios({**overrides, **_at_phase(content.parameters, overrides["pitch"], phase)})


def phase_unknown(content: ParameterFile, samples: int, seed: int) -> Scenarios:
    """Return the draws of `phase_known`, but with the groove phase uniform over a pitch."""
    overrides = _draws(content, MOTION_KEYS, samples, seed, _MOTION_STREAM)
    turn = np.random.default_rng([seed, 2]).uniform(-0.5, 0.5, samples)
    phase = turn * overrides["pitch"]
    return Scenarios({**overrides, **_at_phase(content.parameters, overrides["pitch"], phase)})


def power_draws(content: ParameterFile, samples: int, seed: int) -> dict[str, Array]:
    """Return draws of the parameters that affect only the power, by key."""
    return _draws(content, POWER_KEYS, samples, seed, _POWER_STREAM)


def every_phase(parameters: Parameters) -> Scenarios:
    """Return the parameters at groove phases evenly spaced over a pitch; see `phase_guard`."""
    turn = (np.arange(_PHASES) + 0.5) / _PHASES - 0.5
    pitch = np.full(_PHASES, parameters.pitch)
    return Scenarios(_at_phase(parameters, pitch, turn * parameters.pitch))


def phase_guard(parameters: Parameters) -> float:
    """Return the additional margin (m) that covers the phases between those of `every_phase`.

    A gait that keeps its grooves with this margin at the phases of `every_phase` keeps them without the margin at any
    phase. The reason holds for slow gaits, whose viscous friction is negligible: the travel c from threshold to
    threshold determines their grooves (`worm_model.simulation.closed_form.switching_travel`). A shift of the phase by
    less than the spacing of these phases affects the grooves at most as much as an increase of c by the spacing. A
    margin δ_m increases c by δ_m·(1 + k_dis/k_eng).
    """
    return parameters.pitch / _PHASES * deflected_share(parameters)


def _at_phase(parameters: Parameters, pitch: Array, phase: Array) -> dict[str, Array]:
    """Return the initial lengths (m) that result in groove phases (m). Phases are wrapped to ± half a pitch."""
    wrapped = phase - pitch * np.round(phase / pitch)
    return {"initial_length": front_groove(parameters) * pitch + wrapped}


def _deviates(samples: int, seed: int, stream: int) -> Array:
    """Return standard normal deviates (samples,), limited to ± `_MOST_DEVIATIONS`."""
    return _cut(np.random.default_rng([seed, stream]).standard_normal(samples))


def _cut(deviate: Array) -> Array:
    return np.clip(deviate, -_MOST_DEVIATIONS, _MOST_DEVIATIONS)


def correlated(
    deviates: Mapping[str, Array], correlations: Mapping[tuple[str, str], float]
) -> dict[str, Array]:
    """Return correlated standard normal deviates by key, computed from independent ones of shape (n,).

    Correlations of keys without deviates are ignored. Inconsistent correlations, which rounding can cause, are replaced
    by consistent ones near them.
    """
    keys = list(deviates)
    matrix = np.eye(len(keys))
    for (a, b), correlation in correlations.items():
        if a in deviates and b in deviates:
            i, j = keys.index(a), keys.index(b)
            matrix[i, j] = matrix[j, i] = correlation
    values, vectors = np.linalg.eigh(matrix)
    root = vectors * np.sqrt(np.maximum(values, 0.0)) @ vectors.T
    root /= np.linalg.norm(root, axis=1, keepdims=True)
    return dict(zip(keys, root @ np.array(list(deviates.values())), strict=True))


def _offset(deviate: Array, reach: tuple[float, float]) -> Array:
    """Return standard normal deviates (n,) as offsets from a value, in its unit; ``reach`` as from `reach_of`."""
    below, above = reach
    share = _cut(deviate) / _NORMAL_95
    return np.where(share > 0.0, share * above, share * below)


def _least(key: str, value: float) -> float:
    """Return the smallest permitted draw: a tenth of ``value`` if a parameter is never negative, else its low bound."""
    if key == TRAVEL:
        return -math.inf
    lowest = float(ROWS[key]["low"])
    return 0.1 * value if lowest >= 0.0 else lowest


def _draws(
    content: ParameterFile, keys: Iterable[str], samples: int, seed: int, stream: int
) -> dict[str, Array]:
    """Return draws (samples,) of parameters by key, limited to admissible values.

    The switching threshold is the drawn one minus the drawn travel error, which is not returned.
    """
    values = {**content.parameters.as_dict(), TRAVEL: (content.travel_error or PRIOR).value}
    independent = {key: _deviates(samples, seed, number) for number, key in enumerate(keys, stream)}
    drawn = {
        key: np.maximum(
            values[key] + _offset(deviates, reach_of(content, key)), _least(key, values[key])
        )
        for key, deviates in correlated(independent, content.correlations).items()
    }
    if TRAVEL in drawn:
        # `Parameters` requires p_sw ≥ d/2, so that a fin that switches does not switch back, and p_sw > δ_c/2.
        least = np.maximum(0.5 * drawn["pitch"], 0.5 * drawn["clearance"]) * 1.001
        travelled = drawn["switching_threshold"] - drawn.pop(TRAVEL)
        drawn["switching_threshold"] = np.maximum(travelled, least)
    return drawn
