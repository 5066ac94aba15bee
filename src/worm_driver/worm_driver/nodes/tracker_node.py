# SPDX-License-Identifier: Apache-2.0
"""Node ``tracker``: publishes the positions of both modules, measured in camera images."""

import sys
import time
from pathlib import Path

import numpy as np
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Image

from worm_driver.driver_errors import ImageError, SetupError, TrackingError
from worm_driver.nodes import driver_messages
from worm_driver.nodes.driver_messages import PositionPublisher
from worm_driver.tracking import vision
from worm_driver.tracking.image_sources import CameraThread, check_size
from worm_driver.tracking.tracker import Tracker as ModuleTracker
from worm_driver.tracking.tracker import TrackerReport
from worm_driver.tracking.tracker_setup import TOPIC, load_setup, rows
from worm_msgs.node_command import declare
from worm_msgs.ros_process import ShutdownRequest, freeze_garbage_collection

REJECTIONS = (TrackingError,)
_NANOSECONDS = 10**9


class TrackerNode(Node):
    """Node that measures the positions in images and publishes them."""

    def __init__(self) -> None:
        super().__init__("tracker")
        declare(self, rows)
        texts = {row.name: str(self.get_parameter(row.name).value) for row in rows()}
        self._setup = load_setup(_setup_path(texts["setup_file"]))
        self._detector = vision.MarkerDetector(self._setup.dictionary)
        from_topic = texts["source"] == TOPIC
        if not from_topic and not texts["source"].startswith("/dev/"):
            raise SetupError(
                f"source is {texts['source']!r}: it must be topic or a camera such as /dev/video0. "
                "The command track processes videos and folders of images"
            )
        self._tracker = ModuleTracker(self._setup)
        self._report = TrackerReport(texts["source"])
        self._positions = PositionPublisher(self, 10)
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self._camera: CameraThread | None = None
        self._qos_incompatible = False
        if from_topic:
            # An image is sent in fragments, of which a best-effort subscriber loses some. A reliable subscriber does
            # not match a best-effort camera; the middleware then reports incompatible QoS.
            self._subscribe(ReliabilityPolicy.RELIABLE)
        else:
            size, rate = self._tracker.camera.size, self._setup.rate
            arrival = self.create_guard_condition(self._on_arrival)
            self._camera = CameraThread(texts["source"], size, rate, arrival.trigger)
            self._camera.start()
        self.create_timer(1.0, self._publish_report)

    @property
    def failure(self) -> ImageError | None:
        """Error of the camera that ends the node; None while it runs."""
        return None if self._camera is None else self._camera.failure

    def _subscribe(self, reliability: ReliabilityPolicy) -> None:
        self._images = self.create_subscription(
            Image,
            "camera/image_raw",
            self._on_image,
            QoSProfile(depth=2, reliability=reliability),
            event_callbacks=SubscriptionEventCallbacks(incompatible_qos=self._on_incompatible),
        )

    def _on_incompatible(self, _: object) -> None:
        # Handled at the next report: a subscription must not be destroyed within its own event.
        self._qos_incompatible = True

    def close(self) -> None:
        """Close the camera."""
        if self._camera is not None:
            self._camera.close()

    # --- images in ------------------------------------------------------------------------------

    def _on_image(self, message: Image) -> None:
        try:
            data = np.frombuffer(message.data, np.uint8)
            size = message.height, message.width, message.step
            image = vision.grey(data, *size, message.encoding)
        except ImageError as error:
            self._reject_images(str(error))
            return
        self._see(image, message.header.stamp)

    def _on_arrival(self) -> None:
        assert self._camera is not None
        while (frame := self._camera.next_frame()) is not None:
            age = time.monotonic() - frame.time
            now = self.get_clock().now().nanoseconds
            self._see(frame.image, _time(now - round(age * _NANOSECONDS)))

    # --- positions out --------------------------------------------------------------------------

    def _see(self, image: vision.Image, stamp: Time) -> None:
        try:
            check_size(image, self._tracker.camera.size, "the image")
        except ImageError as error:
            self._reject_images(str(error))
            return
        nanoseconds = stamp.sec * _NANOSECONDS + stamp.nanosec
        sample = self._tracker.see(self._detector.detect(image), nanoseconds / _NANOSECONDS)
        self._report.count(sample)
        if sample.event:
            self.get_logger().warning(sample.event)
        exposed = _time(nanoseconds - round(self._setup.delay * _NANOSECONDS))
        self._positions.publish(exposed, sample.rear, sample.front)

    def _reject_images(self, problem: str) -> None:
        if self._report.set_problem(problem):
            self.get_logger().error(problem)

    def _publish_report(self) -> None:
        if self._qos_incompatible:
            self._qos_incompatible = False
            self.destroy_subscription(self._images)
            self._subscribe(ReliabilityPolicy.BEST_EFFORT)
        stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(
            driver_messages.diagnostics(
                [self._report.next_report()], stamp, self.get_namespace().strip("/")
            )
        )


def _setup_path(text: str) -> Path:
    if not text:
        raise SetupError(
            "setup_file is missing: set it to the tracker's setup file, as with -p setup_file:=tracker.yaml"
        )
    return Path(text).expanduser()


def _time(nanoseconds: int) -> Time:
    return Time(sec=nanoseconds // _NANOSECONDS, nanosec=nanoseconds % _NANOSECONDS)


def run(ended: ShutdownRequest) -> int:
    """Run the tracker until SIGINT, SIGTERM or SIGHUP, or until the camera fails."""
    node = TrackerNode()
    try:
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        freeze_garbage_collection()
        node.get_logger().info("ready")
        while not ended() and node.failure is None:
            executor.spin_once(timeout_sec=0.05)
    finally:
        node.close()
        node.destroy_node()
    if node.failure is not None:
        print(f"tracker: {node.failure}", file=sys.stderr)  # noqa: T201 (standard error of the command)
        return 1
    return 0
