# SPDX-License-Identifier: Apache-2.0
"""Stage 1: given masses, pitch and unstressed length, with their uncertainty.

The source is a parameter file, or a lab's README with statements such as ``M1 = 0.433 kg`` or ``M1 = 0.433 ± 0.001
kg``. A value without bounds gets the bounds of a ruler or a scale.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from worm_model.identification.fits.estimate import Estimate, not_identifiable
from worm_model.parameters import KEYS, PAPER, ParameterFile, Parameters

LOADS = ("rear_load", "front_load")  # conditions of the runs, which count as exact
# keys whose given values count as measured, even if they have no bounds
MEASURED = ("rear_mass", "front_mass", "unstressed_length", "pitch", *LOADS)
# Default half-widths of the 95 % bounds: a kitchen scale (kg), a ruler (m), a ruler over many ridges (m)
READING = {
    "rear_mass": 1e-3,
    "front_mass": 1e-3,
    "unstressed_length": 5e-4,
    "pitch": 5e-5,
}
README = "README.md"
_SYMBOLS = {"M1": "rear_mass", "M2": "front_mass", "L_free": "unstressed_length", "d": "pitch"}
_UNITS = {"kg": 1.0, "g": 1e-3, "m": 1.0, "mm": 1e-3}
_NUMBER = r"([0-9]+(?:\.[0-9]*)?(?:[eE][+-]?[0-9]+)?)"
_UNIT = r"(kg|g|mm|m)\b"
# Groups: symbol; value; unit of the value, which may be missing if the bound has a unit; bound after ±; its unit.
_STATEMENT = re.compile(
    rf"\b(M1|M2|L_free|d)\s*=\s*{_NUMBER}\s*(?:{_UNIT})?(?:\s*(?:±|\+/-|\+-)\s*{_NUMBER}\s*{_UNIT})?"
)
DEFAULT_SOURCE = "the paper"


@dataclass(frozen=True)
class ReferenceValues:
    """Given parameters with known intervals.

    Attributes:
        parameters: the given values.
        intervals: known 95 % intervals by key.
        source: source of the values, as text.
        others: for each value that does not come from ``source``, its source as text, by key.
        fitted_otherwise: True if ``parameters`` selects a power model that differs from the one with which the given
            c_b and α_P were fitted.
    """

    parameters: Parameters
    intervals: Mapping[str, tuple[float, float]]
    source: str
    others: Mapping[str, str] = field(default_factory=dict)
    fitted_otherwise: bool = False

    def with_one_sided_cable(self) -> ReferenceValues:
        """Return the values for the power model of a cable that cannot push."""
        other = not self.parameters.one_sided_cable
        parameters = self.parameters.replace(one_sided_cable=True)
        return replace(self, parameters=parameters, fitted_otherwise=other)

    def estimate(self, key: str) -> Estimate:
        """Return the given value; it is not identifiable if it was neither measured nor given with bounds."""
        value = float(getattr(self.parameters, key))
        note = f"as given by {self.others.get(key, self.source)}"
        if key in self.intervals:
            low, high = self.intervals[key]
            return Estimate(value, low, high, True, note)
        if key in MEASURED:
            reading = READING.get(key, 0.0)
            return Estimate(value, value - reading, value + reading, True, note)
        return not_identifiable(value, note)


def reference_by_file(content: ParameterFile, source: str) -> ReferenceValues:
    """Return the reference values of a parameter file."""
    return ReferenceValues(content.parameters, content.intervals, source)


def reference_by_folder(folder: Path) -> ReferenceValues:
    """Return the values in the README of a lab's folder; the paper's values replace missing ones."""
    readme = folder / README
    text = readme.read_text(encoding="utf-8", errors="replace") if readme.is_file() else ""
    values: dict[str, float] = {}
    intervals: dict[str, tuple[float, float]] = {}
    for symbol, number, unit, bound, bound_unit in _STATEMENT.findall(text):
        if not (unit or bound_unit):
            continue
        key = _SYMBOLS[symbol]
        values[key] = float(number) * _UNITS[unit or bound_unit]
        if bound:
            half = float(bound) * _UNITS[bound_unit]
            intervals[key] = (values[key] - half, values[key] + half)
    if not values:
        return ReferenceValues(PAPER, {}, DEFAULT_SOURCE)
    source = f"{README} of {folder.resolve().name}"
    others = {key: DEFAULT_SOURCE for key in KEYS if key not in values}
    return ReferenceValues(PAPER.replace(**values), intervals, source, others)
