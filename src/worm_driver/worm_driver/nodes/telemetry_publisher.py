# SPDX-License-Identifier: Apache-2.0
"""Publisher of the driver's topics: snapshots of the cycles, power samples, and each change of the gait state."""

import math
from typing import Any

from rclpy.duration import Duration
from rclpy.lifecycle import LifecycleNode
from rclpy.qos import QoSProfile
from rclpy.qos_overriding_options import QoSOverridingOptions
from sensor_msgs.msg import JointState

from worm_driver.control.emergency import EmergencyLatch
from worm_driver.control.hardware import Hardware
from worm_driver.control.robot import CycleSnapshot
from worm_driver.gait.gait_player import Phase, PlayerState
from worm_driver.nodes import driver_messages
from worm_driver.nodes.driver_messages import ClockPair, Stamps
from worm_driver.power.ina219 import PowerSample
from worm_msgs.msg import BodyLength, GaitState, Power
from worm_msgs.qos import LATCHED

#: Longest wait for the delivery of the last messages of a topic.
_DELIVERY = Duration(seconds=0.5)
#: Reliable, and deep enough for the messages that accumulate while the executor's thread waits for a processor.
_TELEMETRY = QoSProfile(depth=200)
#: A user may override history, depth and reliability by parameters such as
#: qos_overrides./worm/power.publisher.reliability.
_OPEN = QoSOverridingOptions.with_default_policies()


class TelemetryPublisher:
    """Publisher of the telemetry of a robot, see `open`.

    Attributes:
        latest: latest snapshot of the open robot; None while no robot is open.
    """

    def __init__(self, node: LifecycleNode, stamps: Stamps, emergency: EmergencyLatch) -> None:
        def publisher(kind: type, topic: str) -> Any:
            return node.create_publisher(kind, topic, _TELEMETRY, qos_overriding_options=_OPEN)

        self._logger = node.get_logger()
        self._stamps = stamps
        self._emergency = emergency
        self._joint_states = publisher(JointState, "joint_states")
        self._commanded = publisher(BodyLength, "body_length/commanded")
        self._cable = publisher(BodyLength, "body_length/cable")
        self._power = publisher(Power, "power")
        self._gait_state = node.create_publisher(GaitState, "gait_state", LATCHED)
        self._shown: tuple[object, ...] | None = None
        self._faulty = False
        self.latest: CycleSnapshot | None = None

    def open(self, hardware: Hardware) -> None:
        """Set the robot whose data follow."""
        self._joints = hardware.joint_names, hardware.joint_models
        self._initial_length = hardware.settings.body.initial_length

    def on_power(self, sample: PowerSample) -> None:
        """Publish a power sample."""
        self._power.publish(driver_messages.power(sample, self._stamps.clocks()))

    def show_inactive(self, reason: str) -> None:
        """Publish the state INACTIVE if the reason or the emergency stop has changed."""
        shown = (reason, self._emergency.on)
        if shown == self._shown:
            return
        self._shown, self.latest = shown, None
        message = GaitState(
            state=GaitState.INACTIVE, message=reason, emergency_stop=self._emergency.on
        )
        message.header.stamp = self._stamps.now()
        self._gait_state.publish(message)

    def deliver(self) -> None:
        """Wait for the delivery of the last messages, because the end of the node discards messages in transit."""
        for publisher in (self._joint_states, self._cable, self._power, self._gait_state):
            publisher.wait_for_all_acked(_DELIVERY)

    def on_snapshot(self, snapshot: CycleSnapshot) -> None:
        """Publish the snapshot of a cycle."""
        self.latest = snapshot
        initial, clocks = self._initial_length, self._stamps.clocks()
        self._joint_states.publish(driver_messages.joint_state(*self._joints, snapshot, clocks))
        for publisher, source, time, change in (
            (self._commanded, BodyLength.COMMANDED, snapshot.command_time, snapshot.commanded),
            (self._cable, BodyLength.CABLE, snapshot.read_time, snapshot.cable),
        ):
            if not math.isnan(change):
                publisher.publish(
                    driver_messages.body_length(source, time, change, initial, clocks)
                )
        self._show_gait_state(snapshot, clocks)

    def _show_gait_state(self, snapshot: CycleSnapshot, clocks: ClockPair) -> None:
        player = snapshot.player
        run = player.active_run
        shown = (
            snapshot.active,
            snapshot.homed,
            self._emergency.on,
            player.phase,
            player.message,
            run and (run.number, run.onset, run.cycles, run.cycle(snapshot.command_time)),
        )
        if shown != self._shown:
            self._log_fault(player)
            self._shown = shown
            self._gait_state.publish(
                driver_messages.gait_state(snapshot, clocks, emergency_stop=self._emergency.on)
            )

    def _log_fault(self, player: PlayerState) -> None:
        """Log a fault once, as an error with its cause and what to do."""
        is_fault = player.phase is Phase.FAULT
        if is_fault and not self._faulty:
            self._logger.error(
                f"FAULT: {player.message}. The robot holds, as far as its servos have torque. Remove the cause, then "
                "deactivate and activate; after a hardware error deactivate, reboot, home, activate. deactivate "
                "releases the torque at once: a contracted robot springs back"
            )
        self._faulty = is_fault
