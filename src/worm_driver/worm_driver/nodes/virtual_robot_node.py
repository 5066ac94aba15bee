# SPDX-License-Identifier: Apache-2.0
"""The virtual robot as a process: doors for the driver, the camera and the faults as a ROS node."""

import argparse
import logging
import math
import sys
import threading
from collections import deque
from collections.abc import Callable, Sequence
from pathlib import Path

from rclpy.duration import Duration
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.time import Time
from rclpy.utilities import remove_ros_args

from worm_driver.virtual_robot.camera import TrackerSample
from worm_driver.virtual_robot.virtual_robot import VirtualRobot
from worm_driver.virtual_robot.virtual_settings import SettingsError, load_settings
from worm_driver.virtual_robot.wire.endpoints import DirectoryError, Endpoints
from worm_driver.virtual_robot.wire.faults import (
    KINDS,
    FaultBoard,
    FaultError,
    make_fault,
    parse_fault,
)
from worm_msgs.msg import BodyLength, Tracker
from worm_msgs.ros_process import ros_process
from worm_msgs.srv import InjectFault

_REST_SAMPLES = 30  # at the start, whose mean is the initial length that the camera goes by
# Python hands the interpreter over after 5 ms by default, too late for an answer on the bus.
_SWITCH_INTERVAL = 0.0002  # s
_SIGNAL_LATENCY = 0.1  # s, after which a signal is noticed at the latest

log = logging.getLogger("virtual_robot")


class VirtualRobotNode(Node):
    """Publishes what the camera sees, and takes faults."""

    def __init__(self, robot: VirtualRobot, directory: Path) -> None:
        super().__init__("virtual_robot")
        self.endpoints = Endpoints(robot, directory, self._take_samples)
        self._samples: deque[TrackerSample] = deque()
        self._lengths_at_rest: list[float] = []
        self._tracker = self.create_publisher(Tracker, "tracker", 10)
        self._length = self.create_publisher(BodyLength, "body_length/measured", 10)
        self._arrival = self.create_guard_condition(self._publish_samples)
        self.create_service(InjectFault, "inject_fault", self._inject)

    def _take_samples(self, samples: list[TrackerSample]) -> None:
        """In the serving thread: hands over to the executor's."""
        self._samples.extend(samples)
        self._arrival.trigger()

    def _publish_samples(self) -> None:
        while self._samples:
            sample = self._samples.popleft()
            stamp = self._stamp(sample).to_msg()
            message = Tracker(
                rear_position=sample.rear_position, front_position=sample.front_position
            )
            message.header.stamp = stamp
            self._tracker.publish(message)
            if not math.isnan(sample.length):  # a hidden marker gives no length
                self._publish_length(sample.length, stamp)

    def _publish_length(self, length: float, stamp: object) -> None:
        if len(self._lengths_at_rest) < _REST_SAMPLES:
            self._lengths_at_rest.append(length)
        initial = sum(self._lengths_at_rest) / len(self._lengths_at_rest)
        message = BodyLength(
            source=BodyLength.MEASURED, length=length, length_change=length - initial
        )
        message.header.stamp = stamp
        self._length.publish(message)

    def _stamp(self, sample: TrackerSample) -> Time:
        age = self.endpoints.now() - sample.time
        return self.get_clock().now() - Duration(nanoseconds=round(age * 1e9))

    def _inject(
        self, request: InjectFault.Request, response: InjectFault.Response
    ) -> InjectFault.Response:
        if request.name == "clear":
            self.endpoints.clear_faults()
            response.success, response.message = True, "all faults are over"
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
        self.endpoints.inject(fault)
        response.success, response.message = True, f"{fault.name}: {KINDS[fault.name].text}"
        return response


def _parse_arguments(arguments: Sequence[str]) -> argparse.Namespace:
    faults = "\n".join(f"  {name:18}{kind}" for name, kind in KINDS.items())
    parser = argparse.ArgumentParser(
        prog="virtual_robot",
        description="A worm robot without hardware: opens DIR/servo_bus (serial) and DIR/i2c.sock.",
        epilog=f"faults, with their defaults:\n{faults}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "--directory", type=Path, required=True, metavar="DIR", help="made if it is not there"
    )
    parser.add_argument(
        "--parameters", type=Path, metavar="FILE", help="default: the installed one"
    )
    parser.add_argument("--seed", type=int, metavar="N", help="default: the parameter file's")
    parser.add_argument(
        "--fault",
        action="append",
        default=[],
        metavar="NAME[:KEY=VALUE,…][@SECONDS]",
        help="keys: target (a servo's id), duration (s), count, value; may be repeated",
    )
    return parser.parse_args(arguments)


def _make_robot(arguments: argparse.Namespace) -> VirtualRobot:
    settings = load_settings(arguments.parameters)
    if arguments.seed is not None:
        settings = settings.with_seed(arguments.seed)
    return VirtualRobot(settings, FaultBoard(parse_fault(text) for text in arguments.fault))


def _serve(node: VirtualRobotNode, failures: list[Exception]) -> None:
    """The serving thread; a failure there ends the process."""
    try:
        node.endpoints.run()
    except Exception as error:  # noqa: BLE001 (reported by the main thread)
        failures.append(error)


def _run(robot: VirtualRobot, directory: Path, ended: Callable[[], bool]) -> None:
    """Serves until the process is asked to end. Raises what the serving thread raised."""
    node = VirtualRobotNode(robot, directory)
    failures: list[Exception] = []
    serving = threading.Thread(target=_serve, args=(node, failures), name="serving")
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    try:
        node.endpoints.open()
        serving.start()
        sys.stdout.write(f"ready: {directory}\n")
        sys.stdout.flush()
        while serving.is_alive() and not ended():
            executor.spin_once(timeout_sec=_SIGNAL_LATENCY)
    finally:
        node.endpoints.stop()
        if serving.ident is not None:
            serving.join()
        node.endpoints.close()
        node.destroy_node()
    if failures:
        raise failures[0]


def _refuse(error: Exception) -> int:
    log.error("%s", error)
    return 2


def main(arguments: Sequence[str] | None = None) -> int:
    """The command; returns the exit status."""
    logging.basicConfig(stream=sys.stderr, format="virtual_robot: %(message)s")
    given = sys.argv if arguments is None else ["virtual_robot", *arguments]
    options = _parse_arguments(remove_ros_args(given)[1:])
    try:
        robot = _make_robot(options)
    except (SettingsError, FaultError) as error:
        return _refuse(error)
    sys.setswitchinterval(_SWITCH_INTERVAL)
    try:
        with ros_process(given) as ended:
            _run(robot, options.directory, ended)
    except DirectoryError as error:
        return _refuse(error)
    except Exception:
        log.exception("stopped by an error")
        return 1
    return 0
