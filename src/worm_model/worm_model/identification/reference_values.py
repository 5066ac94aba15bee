# SPDX-License-Identifier: Apache-2.0
"""Stage 1: masses, pitch and unstressed length as given, with their uncertainty.

They come from a parameter file, or from what a lab's README says in words such as ``M1 = 0.433 kg`` or
``M1 = 0.433 ± 0.001 kg``. Bounds that are not given are those of a ruler and a scale.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from worm_model.identification.estimate import Estimate, not_told
from worm_model.parameters import KEYS, PAPER, ParameterFile, Parameters

MEASURED = ("rear_mass", "front_mass", "unstressed_length", "pitch")
# 95 % bounds to each side where none are given: a kitchen scale, a ruler, a ruler over many ridges
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
# value, its unit unless it follows the bounds, the bounds after ±, and their unit
_STATEMENT = re.compile(
    rf"\b(M1|M2|L_free|d)\s*=\s*{_NUMBER}\s*(?:{_UNIT})?(?:\s*(?:±|\+/-|\+-)\s*{_NUMBER}\s*{_UNIT})?"
)
NOT_SAID = "the paper"


@dataclass(frozen=True)
class ReferenceValues:
    """``parameters`` from which identification starts, ``intervals`` as far as known, and the ``source`` in words.

    ``others``: the source of keys of which ``source`` says nothing. ``fitted_otherwise``: c_b and α_P were fitted with
    another form of the power than the one that ``parameters`` asks for.
    """

    parameters: Parameters
    intervals: Mapping[str, tuple[float, float]]
    source: str
    others: Mapping[str, str] = field(default_factory=dict)
    fitted_otherwise: bool = False

    def with_one_sided_cable(self) -> ReferenceValues:
        """The same for a fit of the power of a cable that cannot push."""
        other = not self.parameters.one_sided_cable
        asked = self.parameters.replace(one_sided_cable=True)
        return replace(self, parameters=asked, fitted_otherwise=other)

    def estimate(self, key: str) -> Estimate:
        """A value as given; what was neither measured nor given with bounds is not identifiable."""
        value = float(getattr(self.parameters, key))
        note = f"as given by {self.others.get(key, self.source)}"
        if key in self.intervals:
            low, high = self.intervals[key]
            return Estimate(value, low, high, True, note)
        if key in MEASURED:
            reading = READING[key]
            return Estimate(value, value - reading, value + reading, True, note)
        return not_told(value, note)


def reference_by_file(content: ParameterFile, source: str) -> ReferenceValues:
    """What a parameter file says."""
    return ReferenceValues(content.parameters, content.intervals, source)


def reference_by_folder(folder: Path) -> ReferenceValues:
    """What the README of a lab's folder says, else the paper's values."""
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
        return ReferenceValues(PAPER, {}, NOT_SAID)
    source = f"{README} of {folder.resolve().name}"
    others = {key: NOT_SAID for key in KEYS if key not in values}
    return ReferenceValues(PAPER.replace(**values), intervals, source, others)
