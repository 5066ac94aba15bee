# SPDX-License-Identifier: Apache-2.0
"""Answers requests for gaits from the fronts that are there, one a direction."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from worm_model.gait import FORWARD, REVERSE
from worm_optimizer.robustness.prediction import Prediction
from worm_optimizer.search.optimizer_errors import OptimizerError
from worm_optimizer.search.selection import Objective, Request, select
from worm_optimizer.search.served import ServedFront


@dataclass(frozen=True)
class Answer:
    """``success``, why not or where the gait is from, and the gait or the nearest reachable one, if any."""

    success: bool
    message: str
    prediction: Prediction | None = None


def request_of(objective: int, speed: float, power: float) -> Request:
    """The request of plain numbers; speed in m/s and power in W, each looked at where it matters.

    Raises `OptimizerError` on an unknown objective or a value that no gait can have.
    """
    try:
        wanted = Objective(objective)
    except ValueError:
        known = ", ".join(f"{each.value} {each.name}" for each in Objective)
        raise OptimizerError(f"objective: {objective} is none of {known}") from None
    values = {Objective.MIN_POWER_AT_SPEED: speed, Objective.MAX_SPEED_AT_POWER: power}
    return Request(wanted, values.get(wanted, math.nan))


def answer(
    fronts: Mapping[int, ServedFront], absence: str, direction: int, request: Request
) -> Answer:
    """Answers from the front of the direction; ``absence`` says why there may be none yet."""
    if direction not in (FORWARD, REVERSE):
        return Answer(
            False, f"direction: {direction} is neither {FORWARD} (forward) nor {REVERSE} (reverse)"
        )
    front = fronts.get(direction)
    if front is None:
        return Answer(False, absence)
    choice = select(front.predictions, request)
    if choice.refusal:
        return Answer(False, choice.refusal, choice.prediction)
    origin = f"margin {1e3 * choice.prediction.margin:.2f} mm, {front.reason}"
    return Answer(True, origin, choice.prediction)
