# SPDX-License-Identifier: Apache-2.0
"""The virtual robot as a process: doors for the driver, the camera and the faults as a ROS node."""

import argparse
import logging
import math
import sys
import threading
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from rclpy.duration import Duration
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.time import Time
from rclpy.utilities import remove_ros_args
from std_msgs.msg import Header

from worm_driver.nodes.driver_process import ros_process
from worm_driver.nodes.virtual_camera_node import CameraProcess
from worm_driver.tracking.initial_length import InitialLength
from worm_driver.virtual_robot.camera import TrackerSample
from worm_driver.virtual_robot.camera_images import DEFAULT_FILE as CAMERA_FILE
from worm_driver.virtual_robot.camera_images import load_camera_settings
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
from worm_msgs.srv import InjectFault

_FRAME = "pipe"  # x forward along the axis, z up (REP 103)
_VIRTUAL = "virtual"  # stands for the installed file of the camera
# Python hands the interpreter over after 5 ms by default, too late for an answer on the bus.
_SWITCH_INTERVAL = 0.0002  # s
_SIGNAL_LATENCY = 0.1  # s, after which a signal is noticed at the latest

log = logging.getLogger("virtual_robot")


class VirtualRobotNode(Node):
    """Publishes what the camera sees, and takes faults.

    camera: file of the camera whose images are published in the place of the positions; None: positions are.
    """

    def __init__(self, robot: VirtualRobot, directory: Path, camera: Path | None = None) -> None:
        super().__init__("virtual_robot")
        self.endpoints = Endpoints(robot, directory, self._take_samples)
        self._samples: deque[TrackerSample] = deque()
        self._initial_length = InitialLength()
        self._camera: CameraProcess | None = None
        if camera is None:
            self._tracker = self.create_publisher(Tracker, "tracker", 10)
            self._length = self.create_publisher(BodyLength, "body_length/measured", 10)
        else:
            self._camera = CameraProcess(camera, robot.settings.seed, self.get_namespace())
        self._arrival = self.create_guard_condition(self._publish_samples)
        self.create_service(InjectFault, "inject_fault", self._inject)

    def close(self) -> None:
        """Ends the camera."""
        if self._camera is not None:
            self._camera.close()

    def _take_samples(self, samples: list[TrackerSample]) -> None:
        """In the serving thread: hands over to the executor's."""
        self._samples.extend(samples)
        self._arrival.trigger()

    def _publish_samples(self) -> None:
        while self._samples:
            sample = self._samples.popleft()
            stamp = self._stamp(sample)
            if self._camera is None:
                self._publish(sample, Header(stamp=stamp.to_msg(), frame_id=_FRAME))
            else:
                places = sample.rear_position, sample.front_position
                self._camera.expose(stamp.nanoseconds, *places)

    def _publish(self, sample: TrackerSample, header: Header) -> None:
        self._tracker.publish(
            Tracker(
                header=header,
                rear_position=sample.rear_position,
                front_position=sample.front_position,
            )
        )
        if math.isnan(sample.length):  # a hidden marker gives no length
            return
        change = self._initial_length.change(sample.length)
        source, length = BodyLength.MEASURED, sample.length
        self._length.publish(
            BodyLength(header=header, source=source, length=length, length_change=change)
        )

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


def _camera_file(text: str) -> Path:
    """The file that --camera names."""
    return Path(str(CAMERA_FILE)) if text == _VIRTUAL else Path(text)


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
        "--camera",
        nargs="?",
        type=_camera_file,
        const=_camera_file(_VIRTUAL),
        metavar="FILE",
        help="publish images of this rig in the place of positions; default: the installed one",
    )
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
    if arguments.camera is not None:  # whose images have noise of their own
        load_camera_settings(arguments.camera)
        settings = replace(settings, tracker=replace(settings.tracker, noise=0.0))
    return VirtualRobot(settings, FaultBoard(parse_fault(text) for text in arguments.fault))


def _serve(node: VirtualRobotNode, failures: list[Exception]) -> None:
    """The serving thread; a failure there ends the process."""
    try:
        node.endpoints.run()
    except Exception as error:  # noqa: BLE001 (reported by the main thread)
        failures.append(error)


def _run(
    robot: VirtualRobot, directory: Path, camera: Path | None, ended: Callable[[], bool]
) -> None:
    """Serves until the process is asked to end. Raises what the serving thread raised."""
    node = VirtualRobotNode(robot, directory, camera)
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
        node.close()
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
            _run(robot, options.directory, options.camera, ended)
    except DirectoryError as error:
        return _refuse(error)
    except Exception:
        log.exception("stopped by an error")
        return 1
    return 0
