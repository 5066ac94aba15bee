# SPDX-License-Identifier: Apache-2.0
"""Subscriptions to all topics that the console shows of a robot, shared by all pages."""

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
# 2 s at 100 Hz. The twin lags by its delay and is shown together with the robot at the twin's stamp.
_SIGHTINGS = 200
_GROOVES = 400  # stored rear grooves of the twin: 4 s
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
    """Store of the newest message of each topic. Other threads than the node's may call ``snapshot``."""

    def __init__(self, node: Node) -> None:
        self._heard: dict[str, tuple[float, Any]] = {}
        self._sightings: deque[Any] = deque(maxlen=_SIGHTINGS)
        self._grooves: deque[tuple[int, int]] = deque(maxlen=_GROOVES)
        # receive time (s) and newest message that contains the residual
        self._residuals: dict[str, tuple[float, Any]] = {}
        for topic, (kind, qos) in _TOPICS.items():
            node.create_subscription(kind, topic, self._keep(topic), qos)

    def _keep(self, topic: str) -> Any:
        def keep(message: Any) -> None:
            self._heard[topic] = (time.monotonic(), message)
            if topic == "tracker":
                self._sightings.append(message)
            elif topic == "twin/state":
                self._grooves.append((nanoseconds(message.header.stamp), message.rear_groove))
            elif topic == "twin/residuals":  # a sample measures only some of the residuals
                kept = dict.fromkeys(_measured(message), self._heard[topic])
                self._residuals = self._residuals | kept

        return keep

    def snapshot(self) -> Snapshot:
        """Return the latest data, with receive times of the monotonic clock and the robot at the twin's stamp."""
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
            grooves=tuple(self._grooves.copy()),
        )


def _between(earlier: Any, later: Any) -> float:
    """Return the time between the stamps of two messages, s; NaN if one is missing."""
    if earlier is None or later is None:
        return math.nan
    return 1e-9 * (nanoseconds(later.header.stamp) - nanoseconds(earlier.header.stamp))


def _driver_of(message: Any) -> DriverWord | None:
    if message is None:
        return None
    stamps = {
        name: nanoseconds(stamp)
        for name, stamp in (("stamp_ns", message.header.stamp), ("onset_ns", message.onset))
    }
    return value_of(DriverWord, message, message.gait, state=Activity(message.state), **stamps)


def _twin_of(message: Any) -> StateRecord | None:
    if message is None:
        return None
    source = LengthSource(message.length_source)
    stamp_ns = nanoseconds(message.header.stamp)
    return value_of(StateRecord, message, stamp_ns=stamp_ns, length_source=source)


def _measured(residuals: Any) -> list[str]:
    return [name for name in RESIDUALS if math.isfinite(getattr(residuals, name))]


def _residuals_of(message: Any, kept: Mapping[str, tuple[float, Any]]) -> ResidualRecord | None:
    """Return the newest value of each residual; NaN if it is `STALE_S` older than the newest of all."""
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
    """Return the sighting nearest to the stamp of a twin message; without a twin message, the newest."""
    in_time = [
        Sighting(message.rear_position, message.front_position, nanoseconds(message.header.stamp))
        for message in (sightings if twin is not None else sightings[-1:])
    ]
    if twin is None or not in_time:
        return in_time[-1] if in_time else Sighting()
    stamp = nanoseconds(twin.header.stamp)
    return min(in_time, key=lambda sighting: abs(sighting.stamp_ns - stamp))
