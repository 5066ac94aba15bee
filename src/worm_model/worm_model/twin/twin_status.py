# SPDX-License-Identifier: Apache-2.0
"""What the twin says of itself once a second."""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass

from worm_model.twin.records import Health
from worm_model.twin.residuals import health
from worm_model.twin.streams import Verdict
from worm_model.twin.twin_state import TwinState

SILENT_S = 2.0  # without any input, after which health says nothing of the present


class Level(enum.Enum):
    """Of a report."""

    OK = "ok"
    WARN = "warn"
    ERROR = "error"


@dataclass(frozen=True)
class Report:
    """A level, one line and details as text."""

    level: Level
    message: str
    values: tuple[tuple[str, str], ...]


_LEVELS = {
    Health.UNKNOWN: Level.OK,
    Health.HEALTHY: Level.OK,
    Health.SUSPECT: Level.WARN,
    Health.FAULTY: Level.ERROR,
}


def report(state: TwinState, silent_s: float = 0.0) -> Report:
    """The twin's health and the figures behind it, ``silent_s`` after its newest sample came."""
    found, message = health(state.monitor, state.streams.now_ns)
    level = _LEVELS[found]
    if silent_s > SILENT_S:
        level, message = Level.WARN, f"no input for {silent_s:.0f} s: is the driver running?"
    elif not message:
        message = "no length yet" if state.track is None else _sentence(found)
    counts = state.streams.counts
    source = "none" if state.track is None else state.track.rows[-1].knot.source.name.lower()
    values = [
        ("length source", source),
        ("run", "running" if state.run.active else "none"),
        ("initial length (m)", f"{state.run.initial_length:.5f}"),
        ("grooves missed", str(state.anchors.missed)),
        ("grooves missed by power", str(state.watch.missed)),
        ("grooves gained", str(state.anchors.extra)),
    ]
    values += [(f"samples {verdict.value}", str(counts.get(verdict, 0))) for verdict in Verdict]
    values += [
        (f"{name} residual (usual ones)", f"{math.sqrt(channel.mean_square):.2f}")
        for name, channel in sorted(state.monitor.channels.items())
    ]
    return Report(level, message, tuple(values))


def _sentence(level: Health) -> str:
    return "the robot does as expected" if level is Health.HEALTHY else "nothing to compare with"
