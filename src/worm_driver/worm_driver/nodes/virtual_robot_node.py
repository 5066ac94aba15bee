# SPDX-License-Identifier: Apache-2.0
"""Node ``virtual_robot``: ports of the servo bus and of the power sensor, measured positions, and fault injection."""

import argparse
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

from rclpy.duration import Duration
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.time import Time
from rosgraph_msgs.msg import Clock

from worm_driver.nodes.driver_messages import PositionPublisher
from worm_driver.virtual_robot.robot_server import RobotServer
from worm_driver.virtual_robot.virtual_robot import TrackerSample, VirtualRobot
from worm_driver.virtual_robot.virtual_settings import load_settings
from worm_driver.virtual_robot.wire.faults import (
    KINDS,
    FaultBoard,
    FaultError,
    make_fault,
    parse_fault,
)
from worm_msgs.claim import claim_robot
from worm_msgs.conditions import CONDITION_ROWS
from worm_msgs.node_command import declare_none
from worm_msgs.ros_process import ShutdownRequest
from worm_msgs.srv import InjectFault

_DEPTH = 500  # samples that may wait for a slow subscriber
_CLOCK_PERIOD = 0.05  # s, virtual time between two messages on the topic clock
_SIGNAL_LATENCY = 0.1  # s, longest delay until a signal takes effect
_QUIET = 0.5  # s, time without an instruction after which the driver counts as ended


class VirtualRobotNode(Node):
    """Publisher of the measured positions, and server of fault injection.

    Args:
        robot: the virtual robot.
        directory: folder of the ports.
        rate: largest number of virtual seconds per second; None: real time, like a real robot.
    """

    def __init__(self, robot: VirtualRobot, directory: Path, rate: float | None) -> None:
        super().__init__("virtual_robot")
        declare_none(self)
        self._claim = claim_robot(self.get_namespace(), self.context.get_domain_id())
        epoch_ns = self.get_clock().now().nanoseconds
        self.server = RobotServer(
            robot,
            directory,
            self._publish_samples,
            rate=rate,
            epoch_ns=epoch_ns,
            on_time=self._publish_time,
        )
        self._positions = PositionPublisher(self, _DEPTH)
        self._time = self.create_publisher(Clock, "clock", 10) if rate is not None else None
        self._next_tick = 0.0
        self.create_service(InjectFault, "inject_fault", self._inject)

    def close(self) -> None:
        """Release the claim."""
        self._claim.close()

    def _publish_samples(self, samples: list[TrackerSample]) -> None:
        """Publish tracker samples. Runs in the serving thread, because the executor's thread may be late."""
        for sample in samples:
            stamp = self._stamp(sample.time).to_msg()
            self._positions.publish(stamp, sample.rear_position, sample.front_position)

    def _publish_time(self, now: float) -> None:
        """Publish the robot's time (s) for nodes with use_sim_time. Runs in the serving thread."""
        if self._time is not None and now >= self._next_tick:
            self._next_tick = now + _CLOCK_PERIOD
            self._time.publish(Clock(clock=self._stamp(now).to_msg()))

    def _stamp(self, time: float) -> Time:
        """Return the ROS time of the robot's time (s). With --real-time it follows steps of the system clock."""
        server = self.server
        if server.shares_time:
            return Time(nanoseconds=server.epoch_ns + round(time * 1e9))
        age = server.now() - time
        return self.get_clock().now() - Duration(nanoseconds=round(age * 1e9))

    def _inject(
        self, request: InjectFault.Request, response: InjectFault.Response
    ) -> InjectFault.Response:
        if request.name == "clear":
            self.server.clear_faults()
            response.success, response.message = True, "all faults have ended"
            return response
        try:
            fault = make_fault(
                request.name,
                target=request.target or None,
                start=request.delay,
                duration=request.duration or None,
                count=request.count or None,
                value=request.value or None,
            )
        except FaultError as error:
            response.success, response.message = False, str(error)
            return response
        self.server.inject(fault)
        response.success, response.message = True, f"{fault.name}: {KINDS[fault.name].text}"
        return response


def make_robot(arguments: argparse.Namespace) -> VirtualRobot:
    """Return the robot that the options describe. Raises `InputError` for an invalid file, condition or fault."""
    settings = load_settings(arguments.parameters)
    if arguments.seed is not None:
        settings = replace(settings, seed=arguments.seed)
    given = {name: getattr(arguments, name) for name in CONDITION_ROWS}
    given = {name: value for name, value in given.items() if value is not None}
    settings = replace(settings, conditions=replace(settings.conditions, **given))
    return VirtualRobot(settings, FaultBoard(parse_fault(text) for text in arguments.fault))


def run(robot: VirtualRobot, options: argparse.Namespace, ended: ShutdownRequest) -> None:
    """Serve until a signal arrives and the driver has ended. Raise the exception of the serving thread, if any."""
    node = VirtualRobotNode(robot, options.directory, options.rate)
    ended.again = node.server.stop
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    try:
        with ThreadPoolExecutor(1, "serving") as pool:
            node.server.open()
            serving = pool.submit(node.server.run)
            try:
                sys.stdout.write(f"ready: {options.directory}\n")
                sys.stdout.flush()
                # If all processes receive the signal at once, the robot must serve until the driver has released it.
                while not serving.done() and not (ended() and node.server.is_unused(_QUIET)):
                    executor.spin_once(timeout_sec=_SIGNAL_LATENCY)
            finally:
                node.server.stop()
        serving.result()
    finally:
        node.server.close()
        node.close()
        node.destroy_node()
