# SPDX-License-Identifier: Apache-2.0
"""Subscriptions to the topics of a robot: its latest state, and a monitor of the tracker."""

from __future__ import annotations

import dataclasses
import math
import time
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.qos import QoSProfile

from worm_model.run import Activity, LengthSource, nanoseconds
from worm_model.twin.data.records import STALE_S, Health, ResidualRecord, StateRecord
from worm_model.twin.scene import PositionSample
from worm_msgs.msg import (
    BodyLength,
    GaitState,
    Power,
    Tracker,
    TwinResiduals,
    TwinState,
)
from worm_msgs.qos import LATCHED
from worm_optimizer.robot_commands import DriverState, Snapshot

T = TypeVar("T")

RESIDUALS = ("rear_position", "length", "power")
_NEWEST = QoSProfile(depth=1)
# Number of stored tracker messages, 2 s at 100 Hz. The twin lags behind the tracker by less than 2 s.
_SIGHTINGS = 200
_LENGTHS = {
    LengthSource.COMMANDED: "body_length/commanded",
    LengthSource.CABLE: "body_length/cable",
    LengthSource.ESTIMATED: "body_length/estimated",
    LengthSource.MEASURED: "body_length/measured",
}
_TOPICS: Mapping[str, tuple[type, QoSProfile]] = {
    "power": (Power, _NEWEST),
    "tracker": (Tracker, _NEWEST),
    "twin/state": (TwinState, _NEWEST),
    "twin/residuals": (TwinResiduals, _NEWEST),
    **dict.fromkeys(_LENGTHS.values(), (BodyLength, _NEWEST)),
}
_INPUTS = ("tracker", "power", _LENGTHS[LengthSource.COMMANDED])
# Time without a position, in s of the robot's clock, after which the tracker counts as lost. Markers are often hidden
# for a moment.
SILENCE_S = 2.0
LOOK_S = 0.25  # period of the checks, s
_MEASUREMENTS = {"power", "tracker", "twin/state", "twin/residuals"}


class Telemetry:
    """Store of the newest message of each topic. ``snapshot`` may be called in any thread.

    Args:
        node: node in the robot's namespace. Until `subscribe_to_all`, it subscribes only to gait_state.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._subscribed: set[str] = set()
        self._received: dict[str, tuple[float, Any]] = {}
        self._sightings: deque[Any] = deque(maxlen=_SIGHTINGS)
        # for each residual, receive time (s) and content of the newest message that contains it
        self._residuals: dict[str, tuple[float, Any]] = {}
        self._subscribe({"gait_state": (GaitState, LATCHED)})  # which every operator needs

    def subscribe_to_all(self) -> None:
        """Subscribe to all topics."""
        self._subscribe(_TOPICS)

    @property
    def is_complete(self) -> bool:
        """True if messages of power, tracker and twin were received. A configured driver publishes the power."""
        return self._received.keys() >= _MEASUREMENTS

    @property
    def driver(self) -> DriverState | None:
        """Latest state of the driver; None before its first message."""
        received = self._received.get("gait_state")
        return None if received is None else _driver_of(received[1])

    def _subscribe(self, topics: Mapping[str, tuple[type, QoSProfile]]) -> None:
        for topic, (kind, qos) in topics.items():
            if topic not in self._subscribed:
                self._subscribed.add(topic)
                self._node.create_subscription(kind, topic, self._keep(topic), qos)

    def _keep(self, topic: str) -> Any:
        def keep(message: Any) -> None:
            self._received[topic] = (time.monotonic(), message)
            if topic == "tracker":
                self._sightings.append(message)
            elif topic == "twin/residuals":  # a message may contain only some of the residuals
                kept = dict.fromkeys(_measured(message), self._received[topic])
                self._residuals = self._residuals | kept

        return keep

    def snapshot(self) -> Snapshot:
        """Return the latest state of the robot."""
        received = dict(self._received)
        newest = {topic: message for topic, (_, message) in received.items()}
        power = newest.get("power")
        return Snapshot(
            driver=_driver_of(newest.get("gait_state")),
            twin=_twin_of(newest.get("twin/state")),
            residuals=_residuals_of(newest.get("twin/residuals"), self._residuals),
            robot=_robot_at(None, list(self._sightings)),
            robot_at_twin=_robot_at(newest.get("twin/state"), list(self._sightings)),
            lengths={s: newest[topic].length for s, topic in _LENGTHS.items() if topic in newest},
            power=power.power if power is not None else math.nan,
            twin_age=_behind(
                newest.get("twin/state"),
                [newest[topic] for topic in _INPUTS if topic in newest],
            ),
            received={topic: at for topic, (at, _) in received.items()},
        )


def _behind(twin: Any, inputs: list[Any]) -> float:
    """Return the newest stamp of the inputs minus that of the twin, s; NaN if a message is missing.

    An inactive driver publishes no commanded length, while tracker and power continue.
    """
    if twin is None or not inputs:
        return math.nan
    newest = max(nanoseconds(message.header.stamp) for message in inputs)
    return 1e-9 * (newest - nanoseconds(twin.header.stamp))


def _driver_of(message: Any) -> DriverState | None:
    if message is None:
        return None
    stamps = {
        name: nanoseconds(stamp)
        for name, stamp in (("stamp_ns", message.header.stamp), ("onset_ns", message.onset))
    }
    return value_of(DriverState, message, message.gait, state=Activity(message.state), **stamps)


def _twin_of(message: Any) -> StateRecord | None:
    if message is None:
        return None
    source = LengthSource(message.length_source)
    stamp_ns = nanoseconds(message.header.stamp)
    return value_of(StateRecord, message, stamp_ns=stamp_ns, length_source=source)


def _measured(residuals: Any) -> list[str]:
    return [name for name in RESIDUALS if math.isfinite(getattr(residuals, name))]


def _residuals_of(message: Any, kept: Mapping[str, tuple[float, Any]]) -> ResidualRecord | None:
    """Return the newest value of each residual.

    A residual is NaN if its newest value was received more than `STALE_S` before the newest value of all residuals.
    """
    if message is None:
        return None
    newest = max((at for at, _ in kept.values()), default=0.0)
    values = dict.fromkeys([*RESIDUALS, *(f"{name}_scale" for name in RESIDUALS)], math.nan)
    for name, (at, measured) in kept.items():
        if newest - at <= STALE_S:
            values |= {key: getattr(measured, key) for key in (name, f"{name}_scale")}
    known = {"stamp_ns": nanoseconds(message.header.stamp), "health": Health(message.health)}
    return value_of(ResidualRecord, message, **known, **values)


def _robot_at(twin: Any, sightings: list[Any]) -> PositionSample:
    """Return the tracker sample nearest to the stamp of a twin message; without a twin message, the newest sample."""
    in_time = [
        PositionSample(
            message.rear_position, message.front_position, nanoseconds(message.header.stamp)
        )
        for message in (sightings if twin is not None else sightings[-1:])
    ]
    if twin is None or not in_time:
        return in_time[-1] if in_time else PositionSample()
    stamp = nanoseconds(twin.header.stamp)
    return min(in_time, key=lambda sighting: abs(sighting.stamp_ns - stamp))


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


class TrackerWatch:
    """Monitor of the tracker, which runs in the callbacks of a node and ends with the node.

    Args:
        node: node in the robot's namespace.
        now: returns the robot's time (s). The time of a virtual robot stops while it waits for a busy computer.
        say: called with the text of each report, which is one line long.
    """

    def __init__(self, node: Node, now: Callable[[], float], say: Callable[[str], None]) -> None:
        self._now, self._say = now, say
        self._received_at = self._seen_at = now()
        self._lost = False
        node.create_subscription(Tracker, "tracker", self._receive, 10)
        node.create_timer(LOOK_S, self._look, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _receive(self, message: Tracker) -> None:
        self._received_at = self._now()
        if math.isfinite(message.rear_position) and math.isfinite(message.front_position):
            if self._lost:
                self._say(f"the tracker is back after {self._received_at - self._seen_at:.1f} s")
            self._seen_at, self._lost = self._received_at, False

    def _look(self) -> None:
        now = self._now()
        if self._lost or now - self._seen_at < SILENCE_S:
            return
        self._lost = True
        what = (
            "no message of the tracker"
            if now - self._received_at >= SILENCE_S
            else "the tracker does not see both modules"
        )
        self._say(f"{what} for {SILENCE_S:g} s: no speed can be measured until it is back")
