# SPDX-License-Identifier: Apache-2.0
"""Findings of the diagnosis, and phrases of their messages."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from worm_model.twin.cause_table import EventCode

#: code of plain information
INFORMATION = EventCode("", "", "", "")


@dataclass(frozen=True)
class Finding:
    """Result of the diagnosis, and how the twin adapts to it.

    Attributes:
        cycle: number of the cycle to which the result refers.
        description: message for the operator, without the cycle.
        code: code of the event.
        probability: probability of the cause, NaN if not computed.
        grooves: grooves along +x by which the twin moves its anchors.
        shift: shift of the twin's origin in the tracker's frame, m.
        initial_length: new L0, m; NaN if L0 stays.
        explains_position: True if the result explains the earlier position residuals, which then no longer count.
        silent: True if the twin adapts without an event.
    """

    cycle: int
    description: str
    code: EventCode = INFORMATION
    probability: float = math.nan
    grooves: int = 0
    shift: float = 0.0
    initial_length: float = math.nan
    explains_position: bool = False
    silent: bool = False

    @property
    def text(self) -> str:
        """Message for the operator."""
        return f"cycle {self.cycle}: {self.description}"


def count_of_grooves(gained: int) -> str:
    """Return a number of grooves as a phrase, without its sign."""
    return "a groove" if abs(gained) == 1 else f"{abs(gained)} grooves"


def list_of_candidates(shares: Mapping[str, float]) -> str:
    """Return a list of phrases with their probabilities, the most probable first, separated by "or"."""
    ordered = sorted(shares, key=lambda phrase: -shares[phrase])
    return " or ".join(f"{phrase} ({100 * shares[phrase]:.0f} %)" for phrase in ordered)
