# SPDX-License-Identifier: Apache-2.0
"""The twin's records as ROS messages and back, and its settings as ROS parameters; no graph is touched here."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

from builtin_interfaces.msg import Time
from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor
from sensor_msgs.msg import JointState
from std_msgs.msg import Header

from worm_model.gait import Gait, GaitError
from worm_model.twin.forecast import Forecast
from worm_model.twin.records import (
    NANOSECONDS,
    Activity,
    CommandedLength,
    GaitSample,
    LengthRecord,
    MeasuredLength,
    PowerSample,
    ResidualRecord,
    StateRecord,
    TrackerSample,
)
from worm_model.twin.scene import FRAME
from worm_model.twin.twin_settings import TwinSettings
from worm_msgs.msg import (
    BodyLength,
    GaitPrediction,
    GaitState,
    Power,
    Tracker,
    TwinResiduals,
    TwinState,
)
from worm_msgs.msg import Gait as GaitMessage


def nanoseconds(stamp: Any) -> int:
    """Ns of a builtin_interfaces/Time."""
    return stamp.sec * NANOSECONDS + stamp.nanosec


def time_message(stamp_ns: int) -> Time:
    """The builtin_interfaces/Time of a stamp in ns."""
    seconds, rest = divmod(stamp_ns, NANOSECONDS)
    return Time(sec=seconds, nanosec=rest)


# --- messages to samples; they take rclpy's messages and those read from a bag alike ---------------


def commanded_length(message: Any) -> CommandedLength:
    """Of a BodyLength with source COMMANDED."""
    return CommandedLength(nanoseconds(message.header.stamp), message.length_change)


def measured_length(message: Any) -> MeasuredLength:
    """Of a BodyLength with source MEASURED."""
    return MeasuredLength(nanoseconds(message.header.stamp), message.length)


def tracker_sample(message: Any) -> TrackerSample:
    """Of a Tracker."""
    stamp = nanoseconds(message.header.stamp)
    return TrackerSample(stamp, message.rear_position, message.front_position)


def power_sample(message: Any) -> PowerSample:
    """Of a Power; NaN unless the sensor calls it valid."""
    valid = message.status == Power.VALID
    return PowerSample(nanoseconds(message.header.stamp), message.power if valid else math.nan)


def gait_sample(message: Any) -> GaitSample:
    """Of a GaitState; a gait that is not admissible counts as none."""
    gait: Gait | None
    try:
        gait = gait_of(message.gait)
    except GaitError:
        gait = None
    return GaitSample(
        nanoseconds(message.header.stamp),
        Activity(message.state),
        gait,
        nanoseconds(message.onset),
    )


#: of urdf/worm.urdf: x1, and x2 - x1
JOINTS = ("rear_position", "body_length")

#: topic -> (message type, conversion); what the twin listens to
INPUTS: Mapping[str, tuple[type, Any]] = {
    "gait_state": (GaitState, gait_sample),
    "body_length/commanded": (BodyLength, commanded_length),
    "body_length/measured": (BodyLength, measured_length),
    "tracker": (Tracker, tracker_sample),
    "power": (Power, power_sample),
}


# --- records to messages ----------------------------------------------------------------------------


def state_message(record: StateRecord) -> TwinState:
    """The record as TwinState."""
    message = _filled(TwinState(), record)
    message.header.frame_id = FRAME
    return message


def residuals_message(record: ResidualRecord) -> TwinResiduals:
    """The record as TwinResiduals."""
    return _filled(TwinResiduals(), record)


def length_message(record: LengthRecord) -> BodyLength:
    """The record as BodyLength, source ESTIMATED."""
    return _filled(BodyLength(source=BodyLength.ESTIMATED), record)


def joint_state(record: StateRecord) -> JointState:
    """Where the modules are, as the joints of urdf/worm.urdf (m)."""
    return JointState(
        header=Header(stamp=time_message(record.stamp_ns)),
        name=list(JOINTS),
        position=[record.rear_position, record.front_position - record.rear_position],
    )


def _filled(message: Any, record: Any) -> Any:
    """Copies a record's fields; they carry the names of the message's."""
    message.header = Header(stamp=time_message(record.stamp_ns))
    for name, value in vars(record).items():
        if name != "stamp_ns":
            setattr(message, name, value)
    return message


def gait_of(message: Any) -> Gait:
    """Of a Gait; raises `worm_model.gait.GaitError`."""
    return Gait(message.stroke, message.frequency, message.direction, message.margin)


def fill_forecast(response: Any, found: Forecast) -> Any:
    """A forecast as the response of PredictGait."""
    nan = math.nan
    gait = found.robust.gait
    response.success = True
    response.prediction = GaitPrediction(
        gait=GaitMessage(
            stroke=gait.stroke,
            frequency=gait.frequency,
            direction=gait.direction,
            margin=gait.margin,
        ),
        speed=found.robust.speed,
        power=found.robust.power,
        cost_of_transport=found.robust.cost_of_transport,
        grooves_per_cycle=found.robust.grooves_per_cycle,
        groove_phase=found.groove_phase,
        nominal_speed=found.nominal.speed,
        nominal_power=found.nominal.power,
        nominal_cost_of_transport=found.nominal.cost_of_transport,
        nominal_grooves_per_cycle=found.nominal.grooves_per_cycle,
        stroke_to_lower_edge=nan,
        stroke_to_upper_edge=nan,
        success_probability=nan,
        success_probability_any_phase=nan,
    )
    response.time = found.time.tolist()
    response.rear_position = found.rear_position.tolist()
    response.front_position = found.front_position.tolist()
    response.power = found.power.tolist()
    response.energy = found.energy
    response.grooves = found.grooves
    return response


# --- settings ----------------------------------------------------------------------------------------


PARAMETER_FILE = "parameter_file"


def rows() -> list[tuple[str, Any, ParameterDescriptor]]:
    """Name, default and descriptor of every parameter."""
    text = "the model's parameters (YAML); empty: the paper's"
    result: list[tuple[str, Any, ParameterDescriptor]] = [
        (PARAMETER_FILE, "", ParameterDescriptor(description=text))
    ]
    for row in dataclasses.fields(TwinSettings):
        limits = FloatingPointRange(
            from_value=row.metadata["low"], to_value=row.metadata["high"], step=0.0
        )
        descriptor = ParameterDescriptor(
            description=row.metadata["text"], floating_point_range=[limits]
        )
        default: Any = row.default
        result.append((row.name, float(default), descriptor))
    return result


def settings_of(node: Any) -> TwinSettings:
    """The settings as the node's parameters stand."""
    names = [row.name for row in dataclasses.fields(TwinSettings)]
    return TwinSettings(**{name: node.get_parameter(name).value for name in names})
