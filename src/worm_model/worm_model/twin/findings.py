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
    """Sentences that describe findings, with the names of the finding's facts in braces."""

    POSITION_RESET = "the twin resets its position to the tracker's"
    BENT_FINS = (
        "the gait began with bent fins, the rear module {offset_mm:+.1f} mm off its groove, "
        "according to the positions"
    )
    MISFIT = (
        "the parameters do not describe this robot: its residuals are up to {ratio:.0f} times the usual ones, and no "
        "single cause explains them; the twin reports only changes after this cycle"
    )
    NOT_JUDGED = "is not judged: {reason}"
    NOT_JUDGED_RESET = "is not judged: {reason}; the twin resets its position to the tracker's"
    AFTER_GAP = (
        "no data for {blind_s:.1f} s; afterwards the robot is {grooves} {where} than predicted "
        "(position {off_mm:+.1f} mm off); the twin corrects its anchors"
    )
    GROOVES_MISSED = (
        "the robot missed {grooves}{fin} (position {off_mm:+.1f} mm off, beginning {since_s:.1f} s "
        "into the cycle); the twin corrects its anchors"
    )
    GROOVES_GAINED = (
        "the robot gained {grooves} too many (position {off_mm:+.1f} mm off, beginning "
        "{since_s:.1f} s into the cycle); the twin corrects its anchors"
    )
    GROOVES_AGAIN = (
        "since cycle {since} the robot gains {gained} instead of {predicted} grooves per cycle; the twin does not "
        "report further cycles like these"
    )
    ROBOT_MOVED = (
        "the robot was moved by {grooves} {way} the direction of its gait (position {off_mm:+.1f} mm "
        "off, beginning {since_s:.1f} s into the cycle); the twin corrects its anchors"
    )
    CAMERA_MOVED = (
        "the camera was moved: its positions are {off_mm:+.1f} mm off, which is no whole number of "
        "grooves; the twin shifts its origin"
    )
    STEP_AMBIGUOUS = (
        "the cause is ambiguous: {candidates} (position {off_mm:+.1f} mm off, beginning {since_s:.1f} s "
        "into the cycle)"
    )
    STEP_AMBIGUOUS_MOVED = STEP_AMBIGUOUS + "; the twin corrects its anchors"
    NEW_LENGTH = (
        "L0 is {after_mm:.1f} mm instead of {before_mm:.1f} mm, according to positions and power "
        "since the run began"
    )
    BY_POWER = "the power indicates {cause} (probability {percent:.0f} %)"
    LASTING = "lasting change from this cycle on: {change} (probability {percent:.0f} %)"
    CAUSES_AMBIGUOUS = "the cause is ambiguous: {candidates}"
    UNEXPLAINED = "a deviation that no known cause explains"


@dataclass(frozen=True)
class Finding:
    """Result of the diagnosis, and how the twin adapts to it.

    Attributes:
        code: code of the event.
        sentence: sentence that describes the result.
        cycle: number of the cycle to which the result refers.
        facts: values in the sentence, by name.
        probability: probability of the cause, NaN if not computed.
        grooves: grooves along +x by which the twin moves its anchors.
        shift: shift of the twin's origin in the tracker's frame, m.
        initial_length: new L0, m; NaN if L0 stays.
        explains_position: True if the result explains the earlier position residuals, which then no longer count.
        silent: True if the twin adapts without an event.
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
    silent: bool = False

    @property
    def text(self) -> str:
        """Message for the operator."""
        return f"cycle {self.cycle}: {self.sentence.value.format(**self.facts)}"


def count_of_grooves(gained: int) -> str:
    """Return a number of grooves as a phrase, without its sign."""
    return "a groove" if abs(gained) == 1 else f"{abs(gained)} grooves"


def list_of_candidates(shares: Mapping[str, float]) -> str:
    """Return a list of phrases with their probabilities, the most probable first, separated by "or"."""
    ordered = sorted(shares, key=lambda phrase: -shares[phrase])
    return " or ".join(f"{phrase} ({100 * shares[phrase]:.0f} %)" for phrase in ordered)
