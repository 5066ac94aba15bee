# SPDX-License-Identifier: Apache-2.0
"""Stage 1: masses, pitch and unstressed length as given, with their uncertainty.

They come from a parameter file, or from what a lab's README says in words such as ``M1 = 0.433 kg``. Bounds that are
not given are those of a ruler and a scale.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from worm_model.identification.estimate import Estimate
from worm_model.parameters import PAPER, ParameterFile, Parameters

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
_STATEMENT = re.compile(r"\b(M1|M2|L_free|d)\s*=\s*([0-9.]+)\s*(kg|g|mm|m)\b")


@dataclass(frozen=True)
class Given:
    """``parameters`` from which identification starts, ``intervals`` as far as known, and the ``source`` in words."""

    parameters: Parameters
    intervals: Mapping[str, tuple[float, float]]
    source: str

    def estimate(self, key: str) -> Estimate:
        """A value as given; what was neither measured nor given with bounds is not identifiable."""
        value = float(getattr(self.parameters, key))
        if key in self.intervals:
            low, high = self.intervals[key]
            return Estimate(value, low, high, True, f"as given by {self.source}")
        if key in MEASURED:
            reading = READING[key]
            return Estimate(
                value, value - reading, value + reading, True, f"as given by {self.source}"
            )
        nothing = float("nan")
        return Estimate(value, nothing, nothing, False, f"as given by {self.source}")


def given_by_file(content: ParameterFile, source: str) -> Given:
    """What a parameter file says."""
    return Given(content.parameters, content.intervals, source)


def given_by_folder(folder: Path) -> Given:
    """What the README of a lab's folder says, else the paper's values."""
    readme = folder / README
    text = readme.read_text(encoding="utf-8", errors="replace") if readme.is_file() else ""
    found = {
        _SYMBOLS[symbol]: float(number) * _UNITS[unit]
        for symbol, number, unit in _STATEMENT.findall(text)
    }
    if not found:
        return Given(PAPER, {}, "the paper")
    return Given(PAPER.replace(**found), {}, f"{README} of {folder.resolve().name}")
