# SPDX-License-Identifier: Apache-2.0
"""Conversion of messages to samples, of the twin's output to messages, and of ROS parameters to the twin's settings."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Transform, TransformStamped, Vector3
from nav_msgs.msg import Odometry
from sensor_msgs.msg import JointState
from std_msgs.msg import Header

from worm_model.loads import under
from worm_model.parameters import Parameters, load_parameters
from worm_model.run import nanoseconds
from worm_model.twin.data.records import (
    NANOSECONDS,
    RESIDUAL_FIELDS,
    STATE_ROW,
    Event,
    residual_message,
)
from worm_model.twin.data.samples import (
    GAIT_VALUES,
    VALUES,
    SampleKind,
)
from worm_model.twin.scene import FRAME
from worm_model.twin.twin_settings import PARAMETER_FILE, TwinSettings
from worm_msgs.conditions import CONDITION_ROWS, Conditions
from worm_msgs.msg import (
    BodyLength,
    GaitState,
    Power,
    Tracker,
    TwinEvent,
    TwinMemory,
    TwinResiduals,
    TwinState,
)


def time_message(stamp_ns: int) -> Time:
    """Return the builtin_interfaces/Time of a stamp in ns."""
    seconds, rest = divmod(stamp_ns, NANOSECONDS)
    return Time(sec=seconds, nanosec=rest)


# --- conversion of messages to rows of SAMPLE ------------------------------------------------

Row = tuple[int | float, ...]


def gait_sample(message: Any) -> Row:
    """Return the sample of a GaitState, a row of `twin.data.samples.SAMPLE`."""
    stamp, gait = nanoseconds(message.header.stamp), message.gait
    identity = nanoseconds(message.onset), message.state, message.run, message.cycle
    values = (float(getattr(gait, name)) for name in GAIT_VALUES)
    return (stamp, SampleKind.GAIT, *identity, stamp, *values)


def _row(kind: int, message: Any, a: float, b: float = 0.0) -> Row:
    stamp = nanoseconds(message.header.stamp)
    return (stamp, kind, 0, 0, 0, 0, stamp, a, b, *[0.0] * (len(VALUES) - 2))


#: joints of urdf/worm.urdf, with the values x1 and x2 − x1
JOINTS = ("rear_position", "body_length")

#: topics to which the twin subscribes, each with message type and conversion
INPUTS: Mapping[str, tuple[type, Callable[[Any], Row]]] = {
    "gait_state": (GaitState, gait_sample),
    "body_length/commanded": (BodyLength, lambda m: _row(SampleKind.COMMAND, m, m.length_change)),
    "body_length/measured": (BodyLength, lambda m: _row(SampleKind.LENGTH, m, m.length)),
    "tracker": (Tracker, lambda m: _row(SampleKind.POSITION, m, m.rear_position, m.front_position)),
    "power": (
        Power,
        lambda m: _row(SampleKind.POWER, m, m.power if m.status == Power.VALID else math.nan),
    ),
}


# --- conversion of the twin's output to messages ---------------------------------------------------------------

_STATE = tuple(name for name in STATE_ROW.names or () if name != "stamp_ns")


def state_message(row: Any) -> TwinState:
    """Return the TwinState of a row of `twin.data.records.STATE_ROW`."""
    message = _filled(TwinState(), row, _STATE)
    message.header.frame_id = FRAME
    return message


def residuals_message(row: Any, warnings: Mapping[int, str]) -> TwinResiduals:
    """Return the TwinResiduals of a row of `twin.data.records.RESIDUAL_ROW`.

    ``warnings`` contains the texts of the warnings by number.
    """
    message = _filled(TwinResiduals(), row, RESIDUAL_FIELDS)
    message.message = residual_message(row, warnings)
    return message


def length_message(row: Any) -> BodyLength:
    """Return the BodyLength of a row of `twin.core.memory.LENGTH_ROW`, with the source ESTIMATED."""
    return _filled(BodyLength(source=BodyLength.ESTIMATED), row, ("length", "length_change"))


def event_message(event: Event) -> TwinEvent:
    """Return the TwinEvent of an event."""
    return TwinEvent(
        header=Header(stamp=time_message(event.stamp_ns)),
        code=event.code,
        run=event.run,
        cycle=event.cycle,
        probability=event.probability,
        message=event.text,
    )


def memory_message(stamp_ns: int, content: str) -> TwinMemory:
    """Return the TwinMemory of a stored memory."""
    return TwinMemory(header=Header(stamp=time_message(stamp_ns)), content=content)


def joint_state(row: Any) -> JointState:
    """Return the positions (m) of the joints of urdf/worm.urdf for a row of `twin.data.records.STATE_ROW`."""
    rear = float(row["rear_position"])
    return JointState(
        header=Header(stamp=time_message(int(row["stamp_ns"]))),
        name=list(JOINTS),
        position=[rear, float(row["front_position"]) - rear],
    )


UNMEASURED = 1e6  # variance of what the twin does not estimate, m² and so on


def odometry(row: Any, deviation: float) -> Odometry:
    """Return the pose of the rear module, and its speed, for a row of `twin.data.records.STATE_ROW`.

    ``deviation`` is the standard deviation of x1 in m, NaN if it is unknown. REP 105 names the frames.
    """
    message = Odometry(child_frame_id="base_link")
    message.header = Header(stamp=time_message(int(row["stamp_ns"])), frame_id="odom")
    message.pose.pose.position.x = float(row["rear_position"])
    message.twist.twist.linear.x = float(row["rear_velocity"])
    covariance = np.diag([UNMEASURED] * 6)
    message.twist.covariance = covariance.ravel()
    if not math.isnan(deviation):
        covariance[0, 0] = deviation**2
    message.pose.covariance = covariance.ravel()
    return message


def transform(message: Odometry) -> TransformStamped:
    """Return the transform between the frames of an odometry message."""
    place = message.pose.pose.position
    shift = Transform(translation=Vector3(x=place.x, y=place.y, z=place.z))
    return TransformStamped(
        header=message.header, child_frame_id=message.child_frame_id, transform=shift
    )


def _filled(message: Any, row: Any, names: Sequence[str]) -> Any:
    """Fill the stamp of a message and the named fields from a row with the same names; return the message."""
    message.header.stamp = time_message(int(row["stamp_ns"]))
    for name in names:
        setattr(message, name, row[name].item())
    return message


# --- settings ----------------------------------------------------------------------------------------


def robot_of(value: Callable[[str], Any]) -> Parameters:
    """Return the model's parameters from the node's parameter file, under the node's conditions.

    Args:
        value: returns the value of a ROS parameter by name.
    """
    stated = {name: value(name) for name in CONDITION_ROWS}
    return under(Conditions(**stated), load_parameters(value(PARAMETER_FILE)))


def settings_of(node: Any) -> TwinSettings:
    """Return the settings of the twin from the ROS parameters of a node."""
    return TwinSettings(*(node.get_parameter(name).value for name in TwinSettings._fields))
