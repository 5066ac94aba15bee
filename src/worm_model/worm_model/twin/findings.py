# SPDX-License-Identifier: Apache-2.0
"""Findings of the diagnosis as data, and the table of the sentences that describe them."""

from __future__ import annotations

import enum
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from worm_model.twin.cause_table import EventCode

#: code of plain information
INFORMATION = EventCode("", "", "", "")


class Sentence(enum.Enum):
    """Sentences that describe findings; the names in braces are facts of the finding."""

    POSITION_RESET = "the twin resets its position to the tracker's"
    BENT_FINS = (
        "the gait began with bent fins, the rear module {offset_mm:+.1f} mm off its groove, "
        "according to the positions"
    )
    NOT_JUDGED = "is not judged: {reason}"
    NOT_JUDGED_RESET = "is not judged: {reason}; the twin resets its position to the tracker's"
    AFTER_GAP = (
        "no data for {blind_s:.1f} s; afterwards the robot is {grooves} {where} than predicted "
        "(position {off_mm:+.1f} mm off); the twin's anchors were moved there"
    )
    GROOVES_MISSED = (
        "the robot missed {grooves}{fin} (position {off_mm:+.1f} mm off since {since_s:.1f} s after "
        "the cycle's begin); the twin's anchors were moved there"
    )
    GROOVES_GAINED = (
        "the robot gained {grooves} (position {off_mm:+.1f} mm off since {since_s:.1f} s after the "
        "cycle's begin); the twin's anchors were moved there"
    )
    ROBOT_MOVED = (
        "the robot was moved by {grooves} {way} its gait (position {off_mm:+.1f} mm off since "
        "{since_s:.1f} s after the cycle's begin); the twin's anchors were moved there"
    )
    CAMERA_MOVED = (
        "the camera was moved: its positions are {off_mm:+.1f} mm off, no whole grooves; the twin's "
        "zero follows"
    )
    STEP_AMBIGUOUS = (
        "cannot distinguish {candidates} (position {off_mm:+.1f} mm off since {since_s:.1f} s after "
        "the cycle's begin)"
    )
    STEP_AMBIGUOUS_MOVED = STEP_AMBIGUOUS + "; the twin's anchors were moved there"
    NEW_LENGTH = (
        "L0 is {after_mm:.1f} mm instead of {before_mm:.1f} mm, according to positions and power "
        "since the run began"
    )
    BY_POWER = "the power is that of {cause} (probability {percent:.0f} %)"
    LASTING = "since then {change} (probability {percent:.0f} %)"
    CAUSES_AMBIGUOUS = "cannot distinguish {candidates}"
    UNEXPLAINED = "a deviation that no known cause explains"


@dataclass(frozen=True)
class Finding:
    """Result of the diagnosis, and how the twin adapts to it.

    Attributes:
        code: code of the event.
        sentence: sentence that describes it.
        cycle: cycle to which it refers.
        facts: values in the sentence, by name.
        probability: probability of the cause, NaN if not computed.
        grooves: grooves along +x by which the robot is further than predicted.
        shift: shift of the tracker's zero, m.
        initial_length: new L0, m; NaN if it stays.
        explains_position: True if it explains the position residuals so far.
    """

    code: EventCode
    sentence: Sentence
    cycle: int
    facts: Mapping[str, Any] = field(default_factory=dict)
    probability: float = math.nan
    grooves: int = 0
    shift: float = 0.0
    initial_length: float = math.nan
    explains_position: bool = False

    @property
    def text(self) -> str:
        """Message for the operator."""
        return f"cycle {self.cycle}: {self.sentence.value.format(**self.facts)}"


def count_of_grooves(gained: int) -> str:
    """Return a number of grooves as a phrase, without its sign."""
    return "a groove" if abs(gained) == 1 else f"{abs(gained)} grooves"


def list_of_candidates(shares: Mapping[str, float]) -> str:
    """Return phrases with their probabilities, the most probable first."""
    ordered = sorted(shares, key=lambda phrase: -shares[phrase])
    return " and ".join(f"{phrase} ({100 * shares[phrase]:.0f} %)" for phrase in ordered)
