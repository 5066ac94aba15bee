# SPDX-License-Identifier: Apache-2.0
"""Outputs of an identification: parameter file and machine-readable summary."""

from __future__ import annotations

import hashlib
from dataclasses import asdict, fields
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from worm_model.identification.fits.actuation_fit import KEYS as ACTUATION
from worm_model.identification.fits.energy import KEYS as ENERGY
from worm_model.identification.fits.estimate import quantile
from worm_model.identification.fits.locomotion import SHARED as LOCOMOTION
from worm_model.identification.fits.run_prediction import Errors
from worm_model.identification.inputs import Inputs
from worm_model.identification.stages import Identification
from worm_model.parameters import FORM, KEYS, MADE_BY, ParameterFile
from worm_model.travel_error import PRIOR

CORRELATED = 0.8  # smallest magnitude of a reported correlation
VERSION = "1.0.0"  # of package.xml


def code_version() -> str:
    """Return a text with the version of this package and the digest of its sources."""
    package = Path(__file__).resolve().parents[2]
    digest = hashlib.sha256()
    for file in sorted(package.rglob("*.py")):
        digest.update(str(file.relative_to(package)).encode() + file.read_bytes())
    return f"worm_model {VERSION}, sources {digest.hexdigest()[:12]}"


def parameter_file(result: Identification, inputs: Inputs) -> ParameterFile:
    """Return values, intervals and provenance of all parameters."""
    intervals = {
        key: (float(e.low), float(e.high))
        for key, e in result.estimates.items()
        if np.isfinite(e.low) and np.isfinite(e.high)
    }
    runs = {
        run.name: {"date": run.recording.date or "not recorded", **run.recording.sources}
        for run in result.runs
    }
    tests = {"bellows": inputs.bellows, "fin": inputs.fin}
    provenance: dict[str, Any] = {
        "made_by": MADE_BY,
        FORM: result.parameters.one_sided_cable,
        "code": code_version(),
        "seed": result.seed,
        "fit": result.fit.verdict.value,
        "given": result.reference.source,
        "not_identified": {
            key: e.note for key, e in result.estimates.items() if not e.identifiable
        },
        "notes": {key: e.note for key, e in result.estimates.items() if e.identifiable and e.note},
        "bench_tests": {name: test.checksum for name, test in tests.items() if test},
        "runs": runs,
    }
    lengths = [run.length.initial_length for run in result.runs]
    spread = {"initial_length": float(np.std(lengths, ddof=1))} if len(lengths) > 1 else {}
    return ParameterFile(
        result.parameters,
        intervals,
        provenance,
        _of_parameters(result),
        spread,
        result.travel_error,
    )


def summary(result: Identification) -> dict[str, Any]:
    """Return the result as a JSON object; unknown numbers are NaN or None."""
    return {
        "fit": result.fit.as_dict(),
        "parameters": {key: e.as_dict() for key, e in result.estimates.items()},
        "travel_error": asdict(result.travel_error or PRIOR),
        "margins": {
            name: {"measured_m": measured, "predicted_m": predicted}
            for name, (measured, predicted) in result.margins.items()
        },
        FORM: result.parameters.one_sided_cable,
        "runs": {name: asdict(error) for name, error in result.held_out.items()}
        or {run.name: dict.fromkeys(error.name for error in fields(Errors)) for run in result.runs},
        "paper": {name: asdict(error) for name, error in result.paper.items()},
        "validation": {name: asdict(error) for name, error in result.validation.items()},
        "clock_offsets": {
            run.name: _clocks(result, index) for index, run in enumerate(result.runs)
        },
        "nuisances": nuisances(result),
        "correlations": [
            {"parameters": [a, b], "correlation": rho} for a, b, rho in correlations(result)
        ],
        "warnings": list(result.warnings),
        "seed": result.seed,
    }


def _clocks(result: Identification, index: int) -> dict[str, float]:
    """Return clock offsets (s) with 95 % half-widths, NaN where the data do not determine the offset."""
    z = quantile(np.inf)
    power, power_deviation = result.power_clock(result.runs[index].name)
    return {
        "camera_behind_servo": float(result.actuation.fit.clock_offset[index]),
        "camera_behind_servo_half_width": z * float(result.actuation.clock_deviation[index]),
        "power_behind_camera": power,
        "power_behind_camera_half_width": z * power_deviation,
    }


def nuisances(result: Identification) -> dict[str, Any]:
    """Return the nuisance parameters and intermediate results."""
    locomotion = result.locomotion
    return {
        "without_dry_friction": dict(
            zip(
                ("viscous_friction", "switching_threshold"),
                locomotion.without_dry_friction,
                strict=True,
            )
        ),
        "onset": locomotion.onset,
        "threshold_scatter": locomotion.fit.scatter.threshold,
        "stiffness_scatter": locomotion.fit.scatter.stiffness,
        "initial_length": {
            run.name: length
            for run, length in zip(result.runs, locomotion.initial_length, strict=True)
        },
        "idle_power": {run.name: run.idle.value for run in result.runs},
    }


def correlations(result: Identification) -> list[tuple[str, str, float]]:
    """Return strongly correlated pairs of estimates, strongest first."""
    strong = [pair for pair in _correlated(result) if abs(pair[2]) >= CORRELATED]
    return sorted(strong, key=lambda pair: -abs(pair[2]))


def _correlated(result: Identification) -> list[tuple[str, str, float]]:
    pairs = _pairs(LOCOMOTION, result.locomotion.correlation)
    pairs += _pairs(ACTUATION, result.actuation.correlation)
    return pairs + _pairs(ENERGY, result.energy.correlation)


def _of_parameters(result: Identification) -> dict[tuple[str, str], float]:
    """Return the known correlations of estimates, by pairs of keys of a parameter file."""
    return {
        (a, b): round(rho, 4)
        for a, b, rho in _correlated(result)
        if {a, b} <= set(KEYS) and np.isfinite(rho)
    }


def _pairs(names: tuple[str, ...], matrix: Any) -> list[tuple[str, str, float]]:
    pairs = combinations(range(len(names)), 2)
    return [(names[i], names[j], float(matrix[i, j])) for i, j in pairs]
