# SPDX-License-Identifier: Apache-2.0
"""The sinusoidal gait (eq:problem_formulation_gait)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

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


@dataclass(frozen=True)
class Gait:
    """A contraction stroke S at a frequency f, u_cmd(t) = −S/2 (1 − cos 2πft).

    ``stroke`` in m, ``frequency`` in Hz, ``direction`` FORWARD (+x) or REVERSE (fins flipped),
    ``margin`` the robustness margin δ_m in m by which the switching threshold is enlarged
    (eq:A1_switch_robust); 0 is the nominal prediction.

    Raises `GaitError` on anything that is not finite or not in range.
    """

    stroke: float
    frequency: float
    direction: int = FORWARD
    margin: float = 0.0

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

    def command(self, time: float) -> float:
        """Commanded length change u_cmd in m (≤ 0) at ``time`` s after the onset."""
        return -0.5 * self.stroke * (1.0 - math.cos(2.0 * math.pi * self.frequency * time))


def _check(name: str, value: float, unit: str, low: float, high: float) -> None:
    if not (math.isfinite(value) and low < value <= high):
        raise GaitError(f"{name}: {value} {unit} is not above {low:g} and at most {high:g} {unit}")
