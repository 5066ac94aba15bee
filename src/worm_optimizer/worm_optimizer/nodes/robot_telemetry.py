# SPDX-License-Identifier: Apache-2.0
"""Subscriptions to the topics of a robot, and its latest state."""

from __future__ import annotations

import dataclasses
import math
import time
from collections import deque
from typing import Any, TypeVar

from rclpy.node import Node
from rclpy.qos import QoSProfile

from worm_model.run import Activity, LengthSource, nanoseconds
from worm_model.twin.data.records import Health, StateRecord
from worm_model.twin.scene import PositionSample
from worm_msgs.msg import BodyLength, GaitState, Power, Tracker, TwinResiduals, TwinState
from worm_msgs.qos import LATCHED
from worm_optimizer.robot_commands import DriverState, Snapshot

T = TypeVar("T")

_NEWEST = QoSProfile(depth=1)
# Number of stored tracker samples, 2 s at 100 Hz. The twin lags behind the tracker by less than 2 s.
_SIGHTINGS = 200
_LENGTHS = {source: f"body_length/{source.name.lower()}" for source in LengthSource}
_MEASUREMENTS: dict[str, type] = {
    "power": Power,
    "tracker": Tracker,
    "twin/state": TwinState,
    "twin/residuals": TwinResiduals,
}
_INPUTS = ("tracker", "power", _LENGTHS[LengthSource.COMMANDED])


class Telemetry:
    """Store of the newest message of each topic. ``snapshot`` may be called in any thread.

    Args:
        node: node in the robot's namespace. Until `subscribe_to_all`, it subscribes only to gait_state.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._has_all = False
        self._received: dict[str, tuple[float, Any]] = {}
        self._sightings: deque[PositionSample] = deque(maxlen=_SIGHTINGS)
        self._subscribe("gait_state", GaitState, LATCHED)  # which every operator needs

    def subscribe_to_all(self) -> None:
        """Subscribe to all topics."""
        if not self._has_all:
            self._has_all = True
            lengths = dict.fromkeys(_LENGTHS.values(), BodyLength)
            for topic, kind in (_MEASUREMENTS | lengths).items():
                self._subscribe(topic, kind, _NEWEST)

    @property
    def is_complete(self) -> bool:
        """True if messages of power, tracker and twin were received. A configured driver publishes the power."""
        return self._received.keys() >= _MEASUREMENTS.keys()

    @property
    def driver(self) -> DriverState | None:
        """Latest state of the driver; None before its first message."""
        if "gait_state" not in self._received:
            return None
        message = self._received["gait_state"][1]
        return value_of(DriverState, message, message.gait, state=Activity(message.state))

    def _subscribe(self, topic: str, kind: type, qos: QoSProfile) -> None:
        def keep(message: Any) -> None:
            self._received[topic] = (time.monotonic(), message)
            if topic == "tracker":
                self._sightings.append(value_of(PositionSample, message, stamp_ns=_stamp(message)))

        self._node.create_subscription(kind, topic, keep, qos)

    def snapshot(self) -> Snapshot:
        """Return the latest state of the robot."""
        received = dict(self._received)
        newest = {topic: message for topic, (_, message) in received.items()}
        power, residuals = newest.get("power"), newest.get("twin/residuals")
        twin, age = _twin_of(newest.get("twin/state")), math.nan
        sightings = list(self._sightings) or [PositionSample()]
        nearest = sightings[-1]
        # An inactive driver publishes no commanded length, while tracker and power continue.
        stamps = [_stamp(newest[topic]) for topic in _INPUTS if topic in newest]
        if twin is not None:
            nearest = min(sightings, key=lambda sighting: abs(sighting.stamp_ns - twin.stamp_ns))
            age = 1e-9 * (max(stamps) - twin.stamp_ns) if stamps else math.nan
        return Snapshot(
            driver=self.driver,
            twin=twin,
            health=None if residuals is None else Health(residuals.health),
            health_message="" if residuals is None else residuals.message,
            robot=sightings[-1],
            robot_at_twin=nearest,
            lengths={s: newest[topic].length for s, topic in _LENGTHS.items() if topic in newest},
            power=math.nan if power is None else power.power,
            twin_age=age,
            received={topic: at for topic, (at, _) in received.items()},
        )


def _stamp(message: Any) -> int:
    return nanoseconds(message.header.stamp)


def _twin_of(message: Any) -> StateRecord | None:
    if message is None:
        return None
    source = LengthSource(message.length_source)
    return value_of(StateRecord, message, stamp_ns=_stamp(message), length_source=source)


def value_of(kind: type[T], *messages: Any, **known: Any) -> T:
    """Return a dataclass whose fields are read from messages by name.

    Args:
        kind: the dataclass.
        messages: messages to read from. Each field is read from the first message that contains it.
        known: values of the fields that are not read from messages.
    """
    names = {row.name for row in dataclasses.fields(kind)} - known.keys()  # type: ignore[arg-type]
    taken = {n: getattr(m, n) for m in reversed(messages) for n in names if hasattr(m, n)}
    return kind(**taken, **known)
