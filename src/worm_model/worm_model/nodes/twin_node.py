# SPDX-License-Identifier: Apache-2.0
"""Digital twin as a ROS node: receives samples, advances the twin and publishes its output.

The node polls its subscriptions every ``POLL_S``, because a callback of the executor costs about 0.2 ms of Python per
message. A SingleThreadedExecutor handles parameters and timers. The delay by polling hardly matters, because
the twin processes samples only when they are older than ``delay_s``.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from nav_msgs.msg import Odometry
from rcl_interfaces.msg import SetParametersResult
from rclpy.clock import Clock, ClockType
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import JointState
from visualization_msgs.msg import MarkerArray

from worm_model.errors import InputError
from worm_model.nodes import twin_messages
from worm_model.nodes.twin_markers import markers
from worm_model.parameters import ParameterError
from worm_model.twin import warm_up
from worm_model.twin.data.records import Event, Severity, StateRecord
from worm_model.twin.data.samples import SAMPLE, SampleKind
from worm_model.twin.scene import LOST_S, PositionSample
from worm_model.twin.stored_memory import is_due, stored_memory
from worm_model.twin.twin import Output, Twin
from worm_model.twin.twin_settings import PUBLISH_TF, rows
from worm_model.twin.twin_status import position_deviation, report
from worm_msgs import qos
from worm_msgs.conditions import ConditionsError
from worm_msgs.msg import BodyLength, TwinEvent, TwinMemory, TwinResiduals, TwinState
from worm_msgs.node_command import declare
from worm_msgs.ros_process import (
    PolledGroup,
    ShutdownRequest,
    exiting_on_signal,
    freeze_garbage_collection,
)

try:
    from tf2_msgs.msg import TFMessage
except ModuleNotFoundError:  # the ROS wheels lack it
    TFMessage = None

POLL_S = 0.02  # time between two polls of the subscriptions
MARKER_PERIOD_S = 0.1
REJECTIONS = (ConditionsError, ParameterError)
SIGHTINGS = 100  # stored samples of the tracker: 3 s of a camera at 30 Hz
BURST = 200  # queue length of publishers that publish many messages per poll after a stall of the machine
DEPTH = 1000  # queue length of each subscription except gait_state

_LATCHED = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
_LEVELS = {
    Severity.INFO: DiagnosticStatus.OK,
    Severity.WARNING: DiagnosticStatus.WARN,
    Severity.ERROR: DiagnosticStatus.ERROR,
}


class TwinNode(Node):
    """Node of the twin. Raises ParameterError for an invalid parameter file, ConditionsError for invalid conditions."""

    def __init__(self) -> None:
        super().__init__("twin")
        declare(self, rows)
        self._twin = self._make_twin()
        self._state = self._twin.start()
        group = PolledGroup()
        self._inputs = [
            self._subscribe(topic, kind, convert, group)
            for topic, (kind, convert) in twin_messages.INPUTS.items()
        ]
        self._states = self.create_publisher(TwinState, "twin/state", BURST)
        self._joints = self.create_publisher(JointState, "twin/joint_states", 10)
        self._odometry = self.create_publisher(Odometry, "twin/odometry", 10)
        self._frames = self.create_publisher(TFMessage, "tf", BURST) if TFMessage else None
        self._residuals = self.create_publisher(TwinResiduals, "twin/residuals", BURST)
        self._lengths = self.create_publisher(BodyLength, "body_length/estimated", BURST)
        self._events = self.create_publisher(TwinEvent, "twin/events", _LATCHED)
        self._memories = self.create_publisher(TwinMemory, "twin/memory", qos.LATCHED)
        self._stored_ns = 0
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self.add_on_set_parameters_callback(self._check_parameters)
        self.add_post_set_parameters_callback(self._apply_parameters)
        self._markers = self.create_publisher(MarkerArray, "twin/markers", 10)
        self._shown: np.void | None = None
        self._residual: np.void | None = None
        # Monotonic times of the last input and of the last state.
        self._received = self._moved = time.monotonic()
        self._sightings: deque[PositionSample] = deque([PositionSample()], maxlen=SIGHTINGS)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(1.0, self._publish_diagnostics, clock=steady)
        self.create_timer(MARKER_PERIOD_S, self._publish_markers, clock=steady)

    def poll(self) -> None:
        """Process all samples received so far, and publish the output."""
        received: list[twin_messages.Row] = []
        # Repeat until all queues are empty. Otherwise, after a stall between the reading of two topics, samples of the
        # first topic would be late.
        while fresh := [row for read in self._inputs for row in read()]:
            received += fresh
        if not received:
            return
        self._received = time.monotonic()
        samples = np.array(received, SAMPLE)
        samples = samples[np.argsort(samples["stamp"], kind="stable")]
        output = self._twin.advance(self._state, samples)
        self._publish(output)
        if is_due(self._state, self._stored_ns):
            self._stored_ns = int(self._state.record["processed_ns"])
            content = stored_memory(self._twin.parameters, self._state)
            self._memories.publish(twin_messages.memory_message(self._stored_ns, content))
        if len(output.states):
            self._shown, self._moved = output.states[-1].copy(), self._received
        if len(output.residuals):
            self._residual = output.residuals[-1].copy()
        for row in samples[samples["kind"] == SampleKind.POSITION]:
            self._sightings.append(
                PositionSample(float(row["a"]), float(row["b"]), int(row["stamp"]))
            )

    def _subscribe(
        self,
        topic: str,
        kind: type,
        convert: Callable[[Any], twin_messages.Row],
        group: PolledGroup,
    ) -> Callable[[], list[twin_messages.Row]]:
        profile = _LATCHED if topic == "gait_state" else DEPTH
        subscription = self.create_subscription(
            kind, topic, lambda _: None, profile, callback_group=group
        )

        def read() -> list[twin_messages.Row]:
            samples: list[twin_messages.Row] = []
            handle = subscription.handle
            with handle:
                while (received := handle.take_message(kind, False)) is not None:
                    samples.append(convert(received[0]))
            return samples

        return read

    def _publish(self, output: Output) -> None:
        for length in output.lengths:
            self._lengths.publish(twin_messages.length_message(length))
        for state in output.states:
            self._states.publish(twin_messages.state_message(state))
        if len(output.states) and self._joints.get_subscription_count():
            self._joints.publish(twin_messages.joint_state(output.states[-1]))
        if len(output.states):
            self._publish_odometry(output.states[-1])
        for residuals in output.residuals:
            self._residuals.publish(twin_messages.residuals_message(residuals, output.warnings))
        for event in output.events:
            self._events.publish(twin_messages.event_message(event))
            self._log(event)

    def _publish_odometry(self, state: np.void) -> None:
        frames = self._frames if self.get_parameter(PUBLISH_TF).value else None
        if not (self._odometry.get_subscription_count() or frames):
            return
        message = twin_messages.odometry(state, position_deviation(self._state, self._residual))
        self._odometry.publish(message)
        if frames:
            frames.publish(TFMessage(transforms=[twin_messages.transform(message)]))

    def _log(self, event: Event) -> None:
        # Three separate calls, because rclpy raises an error if one line of code logs with different severities.
        if event.severity is Severity.ERROR:
            self.get_logger().error(event.text)
        elif event.severity is Severity.WARNING:
            self.get_logger().warning(event.text)
        else:
            self.get_logger().info(event.text)

    # --- parameters -----------------------------------------------------------------------------

    def _make_twin(self) -> Twin:
        robot = twin_messages.robot_of(lambda name: self.get_parameter(name).value)
        return Twin(robot, twin_messages.settings_of(self))

    def _check_parameters(self, parameters: Sequence[Parameter]) -> SetParametersResult:
        new = {parameter.name: parameter for parameter in parameters}
        try:
            twin_messages.robot_of(lambda name: (new.get(name) or self.get_parameter(name)).value)
        except InputError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _apply_parameters(self, _: Sequence[Parameter]) -> None:
        """Use the new parameters from the next sample on, with the present state of the twin."""
        self._twin = self._make_twin()

    # --- markers -------------------------------------------------------------------

    def _publish_markers(self) -> None:
        # While the twin does not advance, no markers are published, so that the previous markers expire.
        silent = time.monotonic() - self._moved > LOST_S
        if self._shown is None or silent or not self._markers.get_subscription_count():
            return
        parameters = self._twin.effective_parameters(self._state)
        shown = StateRecord(*self._shown.item())
        # The twin lags behind. The robot is shown at the measured position whose stamp is nearest to the twin's.
        nearest = min(self._sightings, key=lambda sighting: abs(sighting.stamp_ns - shown.stamp_ns))
        self._markers.publish(markers(shown, nearest, parameters, self._state.direction))

    # --- diagnostics ------------------------------------------------------------------------------

    def _publish_diagnostics(self) -> None:
        diagnosis = report(self._state, self._residual, time.monotonic() - self._received)
        robot = self.get_namespace().strip("/")
        status = DiagnosticStatus(
            level=_LEVELS[diagnosis.level],
            name=f"{robot}/twin: model".lstrip("/"),
            hardware_id=robot,
            message=diagnosis.message,
            values=[KeyValue(key=key, value=value) for key, value in diagnosis.values.items()],
        )
        message = DiagnosticArray(status=[status])
        message.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(message)


def _spin(node: TwinNode, ended: Callable[[], bool]) -> None:
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    while not ended():
        node.poll()
        executor.spin_once(timeout_sec=0.0)
        time.sleep(POLL_S)


def run(ended: ShutdownRequest) -> None:
    """Run the twin until SIGINT or SIGTERM."""
    with exiting_on_signal():
        warm_up.main()  # compile before the first sample
    node = TwinNode()
    freeze_garbage_collection()
    node.get_logger().info("twin ready")
    if TFMessage is None:
        node.get_logger().info("no transform from odom to base_link: tf2_msgs is not installed")
    try:
        _spin(node, ended)
    finally:
        node.destroy_node()
