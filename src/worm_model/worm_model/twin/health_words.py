# SPDX-License-Identifier: Apache-2.0
"""What the health says in words."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from worm_model.twin.records import Health

COMPLAINTS = {
    "position": "the robot is not where the twin expects it",
    "length": "the body does not follow the command as the actuation model expects",
    "power": "the power is not what the motion should cost",
}


def residual_message(row: Any, warnings: Mapping[int, str]) -> str:
    """What is wrong according to a row of RESIDUAL_ROW; ``warnings`` are the texts that it refers to by number."""
    found = [warnings[row["warning"]]] if row["warning"] in warnings else []
    found += [
        f"{text} ({row[f'{name}_size']:.1f} times the usual residual)"
        for name, text in COMPLAINTS.items()
        if row[f"{name}_level"] >= Health.SUSPECT
    ]
    return "; ".join(found)
