# SPDX-License-Identifier: Apache-2.0
"""One subscription to everything that is shown of a robot, for as many as look on."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Mapping
from typing import Any

from rclpy.node import Node
from rclpy.qos import QoSProfile

from worm_model.nodes.twin_messages import nanoseconds
from worm_model.twin.records import Activity, Health, LengthSource, ResidualRecord, StateRecord
from worm_model.twin.scene import Sighting
from worm_model.twin.watch_view import STALE_S
from worm_msgs.msg import BodyLength, GaitState, Power, Tracker, TwinResiduals, TwinState
from worm_msgs.qos import LATCHED
from worm_optimizer.nodes.optimizer_messages import value_of
from worm_optimizer.snapshot import DriverWord, Snapshot

RESIDUALS = ("rear_position", "length", "power")
_NEWEST = QoSProfile(depth=1)
# 2 s at 100 Hz: the twin is behind by its delay, and is shown beside what was seen then
_SIGHTINGS = 200
_LENGTHS = {
    LengthSource.COMMANDED: "body_length/commanded",
    LengthSource.CABLE: "body_length/cable",
    LengthSource.ESTIMATED: "body_length/estimated",
    LengthSource.MEASURED: "body_length/measured",
}
_TOPICS: Mapping[str, tuple[type, QoSProfile]] = {
    "gait_state": (GaitState, LATCHED),
    "power": (Power, _NEWEST),
    "tracker": (Tracker, _NEWEST),
    "twin/state": (TwinState, _NEWEST),
    "twin/residuals": (TwinResiduals, _NEWEST),
    **dict.fromkeys(_LENGTHS.values(), (BodyLength, _NEWEST)),
}


class Telemetry:
    """Keeps the newest message of every topic; ``snapshot`` may be called from another thread than the node's."""

    def __init__(self, node: Node) -> None:
        self._heard: dict[str, tuple[float, Any]] = {}
        self._sightings: deque[Any] = deque(maxlen=_SIGHTINGS)
        self._residuals: dict[str, tuple[float, Any]] = {}  # each with the last message that has it
        for topic, (kind, qos) in _TOPICS.items():
            node.create_subscription(kind, topic, self._keep(topic), qos)

    def _keep(self, topic: str) -> Any:
        def keep(message: Any) -> None:
            self._heard[topic] = (time.monotonic(), message)
            if topic == "tracker":
                self._sightings.append(message)
            elif topic == "twin/residuals":  # of one sample, which measures some of them
                kept = dict.fromkeys(_measured(message), self._heard[topic])
                self._residuals = self._residuals | kept

        return keep

    def snapshot(self) -> Snapshot:
        """What is known now, heard by the monotonic clock; the robot as it was seen at the twin's stamp."""
        heard = dict(self._heard)
        newest = {topic: message for topic, (_, message) in heard.items()}
        power = newest.get("power")
        return Snapshot(
            driver=_driver_of(newest.get("gait_state")),
            twin=_twin_of(newest.get("twin/state")),
            residuals=_residuals_of(newest.get("twin/residuals"), self._residuals),
            robot=_robot_at(newest.get("twin/state"), list(self._sightings)),
            lengths={s: newest[topic].length for s, topic in _LENGTHS.items() if topic in newest},
            power=power.power if power is not None else math.nan,
            twin_age=_between(
                newest.get("twin/state"), newest.get(_LENGTHS[LengthSource.COMMANDED])
            ),
            heard={topic: at for topic, (at, _) in heard.items()},
        )


def _between(earlier: Any, later: Any) -> float:
    """Time between the stamps of two messages in s, NaN where there are not both."""
    if earlier is None or later is None:
        return math.nan
    return 1e-9 * (nanoseconds(later.header.stamp) - nanoseconds(earlier.header.stamp))


def _driver_of(message: Any) -> DriverWord | None:
    if message is None:
        return None
    return value_of(DriverWord, message, message.gait, state=Activity(message.state))


def _twin_of(message: Any) -> StateRecord | None:
    if message is None:
        return None
    source = LengthSource(message.length_source)
    stamp_ns = nanoseconds(message.header.stamp)
    return value_of(StateRecord, message, stamp_ns=stamp_ns, length_source=source)


def _measured(residuals: Any) -> list[str]:
    return [name for name in RESIDUALS if math.isfinite(getattr(residuals, name))]


def _residuals_of(message: Any, kept: Mapping[str, tuple[float, Any]]) -> ResidualRecord | None:
    """What is known of each, as long as it is not older than `STALE_S` beside the newest message."""
    if message is None:
        return None
    newest = max((at for at, _ in kept.values()), default=0.0)
    values = dict.fromkeys([*RESIDUALS, *(f"{name}_scale" for name in RESIDUALS)], math.nan)
    for name, (at, measured) in kept.items():
        if newest - at <= STALE_S:
            values |= {key: getattr(measured, key) for key in (name, f"{name}_scale")}
    known = {"stamp_ns": nanoseconds(message.header.stamp), "health": Health(message.health)}
    return value_of(ResidualRecord, message, **known, **values)


def _robot_at(twin: Any, sightings: list[Any]) -> Sighting:
    """What the tracker said about the stamp of a message of the twin, its newest word without one."""
    in_time = [
        Sighting(message.rear_position, message.front_position, nanoseconds(message.header.stamp))
        for message in (sightings if twin is not None else sightings[-1:])
    ]
    if twin is None or not in_time:
        return in_time[-1] if in_time else Sighting()
    stamp = nanoseconds(twin.header.stamp)
    return min(in_time, key=lambda sighting: abs(sighting.stamp_ns - stamp))
