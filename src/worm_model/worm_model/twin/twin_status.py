# SPDX-License-Identifier: Apache-2.0
"""What the twin says of itself once a second."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from worm_model.twin.records import (
    COMPLAINTS,
    NANOSECONDS,
    Health,
    LengthSource,
    Severity,
    residual_message,
)
from worm_model.twin.twin import TwinState

SAYS_S = 5.0  # after which residuals say nothing of the present any more
SILENT_S = 2.0  # without any input, after which health says nothing of the present


@dataclass(frozen=True)
class Report:
    """A level, one line and details as text."""

    level: Severity
    message: str
    values: tuple[tuple[str, str], ...]


_LEVELS = {
    Health.UNKNOWN: Severity.INFO,
    Health.HEALTHY: Severity.INFO,
    Health.SUSPECT: Severity.WARNING,
    Health.FAULTY: Severity.ERROR,
}


def report(state: TwinState, newest: Any, silent_s: float = 0.0) -> Report:
    """The twin's health and the figures behind it.

    ``newest`` is its last row of residuals, None before the first; ``silent_s`` how long ago its newest sample came.
    """
    m, now = state.record, state.now_ns
    health = Health.UNKNOWN
    if newest is not None and now - newest["stamp_ns"] <= SAYS_S * NANOSECONDS:
        health = Health(int(newest["health"]))
    message = residual_message(newest, state.warnings) if health > Health.HEALTHY else ""
    level = _LEVELS[health]
    if silent_s > SILENT_S:
        level, message = Severity.WARNING, f"no input for {silent_s:.0f} s: is the driver running?"
    elif not message:
        healthy = health is Health.HEALTHY
        text = "the robot does as expected" if healthy else "nothing to compare with"
        message = text if m["moving"] else "no length yet"
    values = [
        ("length source", LengthSource(int(m["source"])).name.lower() if m["moving"] else "none"),
        ("run", "running" if state.is_running else "none"),
        ("initial length (m)", f"{state.initial_length:.5f}"),
        ("grooves missed", str(state.history.missed)),
        ("grooves missed by power", str(state.history.missed_by_power)),
        ("grooves gained", str(state.history.extra)),
    ]
    values += [(f"samples {name}", str(count)) for name, count in state.counts.items()]
    for name in COMPLAINTS:
        if newest is not None and math.isfinite(newest[f"{name}_size"]):
            values.append((f"{name} residual (usual ones)", f"{newest[f'{name}_size']:.2f}"))
    return Report(level, message, tuple(values))
