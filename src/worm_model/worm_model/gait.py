# SPDX-License-Identifier: Apache-2.0
"""The sinusoidal gait (eq:problem_formulation_gait)."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final, get_type_hints

from worm_model.errors import InputError

FORWARD: Final = 1
REVERSE: Final = -1

# The paper's box of gaits (below eq:moo_formulation).
STROKE_RANGE = (0.01, 0.09)  # m
FREQUENCY_RANGE = (0.08, 0.4)  # Hz

MAX_STROKE = 1.0  # m; beyond it a stroke is taken for a wrong unit
MAX_FREQUENCY = 20.0  # Hz
MAX_MARGIN = 0.1  # m


class GaitError(InputError):
    """A gait is not admissible; the message says why."""


def _row(unit: str, meaning: str, default: Any = dataclasses.MISSING) -> Any:
    """Return a field with its unit and meaning as metadata; without a default it must be given."""
    return field(default=default, metadata={"unit": unit, "meaning": meaning})


@dataclass(frozen=True)
class Gait:
    """A contraction stroke S at a frequency f, u_cmd(t) = −S/2 (1 − cos 2πft).

    ``stroke`` in m, ``frequency`` in Hz, ``direction`` FORWARD (+x) or REVERSE (fins flipped),
    ``margin`` the robustness margin δ_m in m by which the switching threshold is enlarged
    (eq:A1_switch_robust); 0 is the nominal prediction.

    The fields are those of the message worm_msgs/msg/Gait. Tables, messages, bags and the kernel take them from here by
    name; a further one needs a default that means what gaits without it were.

    Raises `GaitError` on anything that is not finite or not in range.
    """

    stroke: float = _row("m", "contraction stroke")
    frequency: float = _row("Hz", "frequency")
    direction: int = _row("1", "1 forward, -1 reverse", FORWARD)
    margin: float = _row("m", "robustness margin", 0.0)

    def __post_init__(self) -> None:
        _check("stroke", self.stroke, "m", 0.0, MAX_STROKE)
        _check("frequency", self.frequency, "Hz", 0.0, MAX_FREQUENCY)
        if not 0.0 <= self.margin <= MAX_MARGIN:
            raise GaitError(f"margin: {self.margin} m is not between 0 and {MAX_MARGIN} m")
        if self.direction not in (FORWARD, REVERSE):
            raise GaitError(
                f"direction: {self.direction} is neither {FORWARD} (forward) nor {REVERSE} (reverse)"
            )

    @property
    def period(self) -> float:
        """Duration of a cycle, s."""
        return 1.0 / self.frequency

    def command(self, time: Any) -> Any:
        """Return the commanded length change u_cmd in m (≤ 0) at ``time`` s after the onset, a number or an array."""
        import numpy as np  # here, as the commands' --help imports this module and needs no array

        return -0.5 * self.stroke * (1.0 - np.cos(2.0 * math.pi * self.frequency * time))


def _check(name: str, value: float, unit: str, low: float, high: float) -> None:
    if not (math.isfinite(value) and low < value <= high):
        raise GaitError(f"{name}: {value} {unit} is not above {low:g} and at most {high:g} {unit}")


GAIT_UNITS: Mapping[str, str] = {row.name: row.metadata["unit"] for row in dataclasses.fields(Gait)}
GAIT_MEANINGS: Mapping[str, str] = {
    row.name: row.metadata["meaning"] for row in dataclasses.fields(Gait)
}
GAIT_DEFAULTS: Mapping[str, Any] = {
    row.name: row.default
    for row in dataclasses.fields(Gait)
    if row.default is not dataclasses.MISSING
}
GAIT_TYPES: Mapping[str, Any] = get_type_hints(Gait)
#: column of a table by field: its name and, unless that is 1, its unit
GAIT_COLUMNS: Mapping[str, str] = {
    name: name if unit == "1" else f"{name}_{unit}" for name, unit in GAIT_UNITS.items()
}
#: the fields that shape u_cmd
WAVEFORM = tuple(name for name in GAIT_UNITS if name not in ("direction", "margin"))


def gait_of(source: Any) -> Gait:
    """Return the gait with the fields of a message, a record or a mapping, by name.

    A field that the source lacks has its default. Raises `GaitError` on values that are not admissible.
    """
    if not isinstance(source, Mapping):
        source = {name: getattr(source, name) for name in GAIT_UNITS if hasattr(source, name)}
    return Gait(**{name: GAIT_TYPES[name](source[name]) for name in GAIT_UNITS if name in source})


def check_body(stroke: float, length: float) -> None:
    """Raise `GaitError` unless a stroke in m is shorter than the body, of ``length`` m at rest."""
    if stroke >= length:
        raise GaitError(
            f"stroke: {stroke:g} m; the body is {length:g} m long. Use a stroke below {length:g} m"
        )
