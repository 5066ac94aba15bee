# SPDX-License-Identifier: Apache-2.0
"""Status of the twin for `/diagnostics`."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from worm_model.run import LengthSource
from worm_model.twin.core.memory import POSITION
from worm_model.twin.data.records import COMPLAINTS, NANOSECONDS, Health, Severity, residual_message
from worm_model.twin.twin import TwinState

RESIDUAL_TIMEOUT_S = 5.0  # age of the last residual beyond which the health is UNKNOWN
INPUT_TIMEOUT_S = (
    2.0  # time without input after which missing input is reported instead of the health
)


class TwinReport(NamedTuple):
    """Status with a level, a message of one line, and details by key."""

    level: Severity
    message: str
    values: dict[str, str]


_LEVELS = {
    Health.UNKNOWN: Severity.INFO,
    Health.HEALTHY: Severity.INFO,
    Health.SUSPECT: Severity.WARNING,
    Health.FAULTY: Severity.ERROR,
}


def _quiet_message(state: TwinState, health: Health) -> str:
    """Return the message for a health without a warning."""
    if health is Health.HEALTHY:
        return "the robot behaves as expected"
    if not state.record["start_known"]:
        return "nothing to compare with: the state of the fins is unknown until a cycle has been evaluated"
    return "nothing to compare with"


def _is_recent(state: TwinState, newest: Any) -> bool:
    timeout_ns = RESIDUAL_TIMEOUT_S * NANOSECONDS
    return newest is not None and bool(state.now_ns - newest["stamp_ns"] <= timeout_ns)


def position_deviation(state: TwinState, newest: Any) -> float:
    """Return the standard deviation (m) of x1: the root mean square of its residuals over about 2 s.

    NaN without such residuals, as without a tracker. The arguments are those of `report`.
    """
    if not _is_recent(state, newest):
        return math.nan
    noise_square = state.record["noise_square"][POSITION]
    size = newest["position_size"] * math.sqrt(newest["rear_position_scale"] ** 2 + noise_square)
    return float(size)


def report(state: TwinState, newest: Any, silent_s: float = 0.0) -> TwinReport:
    """Return the twin's health, and the values that explain it.

    Args:
        state: the state of the twin.
        newest: the last row of residuals, None without one.
        silent_s: time since the newest sample arrived, s.
    """
    m = state.record
    health = Health.UNKNOWN
    if _is_recent(state, newest):
        health = Health(int(newest["health"]))
    message = residual_message(newest, state.warnings) if health > Health.HEALTHY else ""
    level = _LEVELS[health]
    if silent_s > INPUT_TIMEOUT_S:
        level, message = Severity.WARNING, f"no input for {silent_s:.0f} s: is the driver running?"
    elif not message:
        message = _quiet_message(state, health) if m["moving"] else "no length yet"
    values = {
        "length_source": LengthSource(int(m["source"])).name.lower() if m["moving"] else "none",
        "run": "running" if state.is_running else "none",
        "initial_length_m": f"{state.initial_length:.5f}",
    }
    for name, count in state.counts.items():
        values[f"samples_{name.replace(' ', '_')}"] = str(count)
    for name in COMPLAINTS:
        if newest is not None and math.isfinite(newest[f"{name}_size"]):
            values[f"{name}_residual_ratio"] = f"{newest[f'{name}_size']:.2f}"
    return TwinReport(level, message, values)
