# SPDX-License-Identifier: Apache-2.0
"""ROS messages of the driver: conversion of its values, stamps, and the publisher of measured positions."""

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Header

from worm_driver.clock import Clock
from worm_driver.control.diagnostics import DiagnosticReport
from worm_driver.control.robot import CycleSnapshot
from worm_driver.driver_errors import RejectedError
from worm_driver.gait.gait_player import Phase
from worm_driver.power.ina219 import PowerSample
from worm_driver.servos.registers import ServoModel
from worm_msgs.gait import Gait, GaitError, gait_of
from worm_msgs.msg import BodyLength, GaitState, Power, Tracker
from worm_msgs.msg import Gait as GaitMessage

_STATE = {
    Phase.IDLE: GaitState.IDLE,
    Phase.RETURNING: GaitState.RESTING,
    Phase.FLIPPING: GaitState.RESTING,
    Phase.TENSIONING: GaitState.RESTING,
    Phase.RESTING: GaitState.RESTING,
    Phase.RUNNING: GaitState.RUNNING,
    Phase.STOPPING: GaitState.STOPPING,
    Phase.HOLDING: GaitState.IDLE,
    Phase.FAULT: GaitState.FAULT,
}


@dataclass(frozen=True)
class ClockPair:
    """Difference between the ROS clock and the monotonic clock, to convert the times of one clock to the other.

    Attributes:
        offset_ns: ROS time minus monotonic time, ns.
    """

    offset_ns: int

    @staticmethod
    def read(ros_now_ns: Callable[[], int], attempts: int = 3) -> "ClockPair":
        """Read both clocks several times, and return the difference from the attempt with the shortest duration."""
        readings = []
        for _ in range(attempts):
            before = time.monotonic_ns()
            ros = ros_now_ns()
            after = time.monotonic_ns()
            readings.append((after - before, ros - (before + after) // 2))
        return ClockPair(min(readings)[1])

    def stamp(self, monotonic: float) -> Time:
        """Return the ROS stamp of a monotonic time (s)."""
        seconds, nanoseconds = divmod(round(monotonic * 1e9) + self.offset_ns, 1_000_000_000)
        return Time(sec=seconds, nanosec=nanoseconds)

    def monotonic(self, stamp: Time) -> float:
        """Return the monotonic time (s) of a ROS stamp."""
        return (stamp.sec * 1_000_000_000 + stamp.nanosec - self.offset_ns) * 1e-9


def joint_state(
    names: Sequence[str], models: Sequence[ServoModel], snapshot: CycleSnapshot, clocks: ClockPair
) -> JointState:
    """Return positions (rad), velocities (rad/s) and torques (N*m) of all servos; NaN for a servo that did not answer.

    The torque is computed from the current. It is NaN for a servo that does not measure its current. If no servo
    measures its current, ``effort`` is empty.
    """
    torques = [
        state.effort * model.torque_constant
        for model, state in zip(models, snapshot.servos, strict=True)
    ]
    return JointState(
        header=Header(stamp=clocks.stamp(snapshot.read_time)),
        name=list(names),
        position=[state.position for state in snapshot.servos],
        velocity=[state.velocity for state in snapshot.servos],
        effort=torques if any(model.measures_current for model in models) else [],
    )


def body_length(
    source: int, time_s: float, change: float, initial: float, clocks: ClockPair
) -> BodyLength:
    """Return the message of a body length.

    Args:
        source: constant of BodyLength, the source of the length.
        time_s: monotonic time of the length, s.
        change: length change, m.
        initial: initial length, m.
        clocks: difference between the clocks.
    """
    return BodyLength(
        header=Header(stamp=clocks.stamp(time_s)),
        source=source,
        length=initial + change,
        length_change=change,
    )


def power(sample: PowerSample, clocks: ClockPair) -> Power:
    """Return the message of a power sample."""
    return Power(
        header=Header(stamp=clocks.stamp(sample.time)),
        status=getattr(Power, sample.status.name),
        bus_voltage=sample.bus_voltage,
        current=sample.current,
        power=sample.power,
    )


def gait_from(message: GaitMessage) -> Gait:
    """Return the gait of a message. Raises RejectedError if a value is not admissible for any robot."""
    try:
        return gait_of(message)
    except GaitError as error:
        raise RejectedError(str(error)) from None


def gait_state(snapshot: CycleSnapshot, clocks: ClockPair, *, emergency_stop: bool) -> GaitState:
    """Return the message of the driver's state in a snapshot."""
    player = snapshot.player
    run = player.active_run
    message = GaitState(
        header=Header(stamp=clocks.stamp(snapshot.command_time)),
        state=_STATE[player.phase] if snapshot.active else GaitState.INACTIVE,
        run=0 if player.run is None else player.run.number,
        message=player.message,
        holding=snapshot.active and player.phase is Phase.HOLDING,
        homed=snapshot.homed,
        emergency_stop=emergency_stop,
    )
    if run is not None:
        message.gait = GaitMessage(**asdict(run.gait))
        message.cycle, message.cycles = run.cycle(snapshot.command_time), run.cycles
        message.message = player.message or run.reason or player.phase.value
        if run.onset is not None:
            message.onset = clocks.stamp(run.onset)
    return message


def diagnostics(reports: Sequence[DiagnosticReport], stamp: Time, robot: str) -> DiagnosticArray:
    """Return the message for /diagnostics. All robots share this topic, so each name begins with ``robot``."""
    return DiagnosticArray(
        header=Header(stamp=stamp),
        status=[
            DiagnosticStatus(
                level=getattr(DiagnosticStatus, report.level.name),
                name=f"{robot}/{report.name}".lstrip("/"),
                message=report.message,
                hardware_id=report.hardware_id or robot,
                values=[KeyValue(key=key, value=value) for key, value in report.values],
            )
            for report in reports
        ],
    )


FRAME = "pipe"  # x forward along the axis, z up (REP 103)
_SAMPLES = 30  # number of first lengths, assumed to be at rest; their mean is the zero of the length changes


class PositionPublisher:
    """Publisher of positions and length. ``depth`` samples may wait for a slow subscriber."""

    def __init__(self, node: Node, depth: int) -> None:
        self._positions = node.create_publisher(Tracker, "tracker", depth)
        self._length = node.create_publisher(BodyLength, "body_length/measured", depth)
        self._sum, self._count = 0.0, 0

    def publish(self, stamp: Time, rear: float, front: float) -> None:
        """Publish the positions (m) of the modules, NaN while one is hidden, and the length if both are visible."""
        header = Header(stamp=stamp, frame_id=FRAME)
        self._positions.publish(Tracker(header=header, rear_position=rear, front_position=front))
        length = front - rear
        if math.isnan(length):
            return
        if self._count < _SAMPLES:
            self._sum += length
            self._count += 1
        change = length - self._sum / self._count
        source = BodyLength.MEASURED
        self._length.publish(
            BodyLength(header=header, source=source, length=length, length_change=change)
        )


class Stamps:
    """Source of a node's stamps.

    Attributes:
        robot_clock: clock of the robot that was configured last; None before. A clean-up does not reset it, so that
            later stamps continue the earlier ones.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self.robot_clock: Clock | None = None

    def clocks(self) -> ClockPair:
        """Return the present difference between the ROS clock and the robot's clock.

        A real robot uses the monotonic clock. So a step of the ROS clock, as by NTP, changes the stamps, but neither
        motion nor metrics.
        """
        clock = self.robot_clock
        if clock is not None and clock.epoch_ns is not None:
            return ClockPair(clock.epoch_ns)  # The ROS time of a virtual robot is its own clock.
        return ClockPair.read(lambda: self._node.get_clock().now().nanoseconds)

    def now(self) -> Time:
        """Return the present stamp."""
        clock = self.robot_clock
        if clock is not None and clock.epoch_ns is not None:
            return ClockPair(clock.epoch_ns).stamp(clock())
        stamp: Time = self._node.get_clock().now().to_msg()
        return stamp

    def monotonic(self) -> float:
        """Return the robot's present time, s."""
        return time.monotonic() if self.robot_clock is None else self.robot_clock()
