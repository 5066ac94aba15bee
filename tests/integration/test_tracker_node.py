# SPDX-License-Identifier: Apache-2.0
"""tracker_node as a process: images over DDS in, positions out."""

import math
from array import array

import numpy as np
import pytest
from camera_rig import LENGTH, SETTINGS, SETUP_FILE
from harness import TIMEOUT_S
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rendered_images import RenderedCamera
from sensor_msgs.msg import Image

from worm_msgs.msg import BodyLength, Tracker

BEST_EFFORT = QoSProfile(depth=2, reliability=ReliabilityPolicy.BEST_EFFORT)


@pytest.fixture(scope="module")
def pictures() -> list[np.ndarray]:
    """Return images of a rear module at 0, 1 and 2 mm; in the last one it is hidden."""
    camera = RenderedCamera(SETTINGS, 5)
    return [camera.image(x, LENGTH) for x in (0.0, 0.001, 0.002, math.nan)]


def image_of(picture: np.ndarray, stamp: int, encoding: str = "mono8") -> Image:
    height, width = picture.shape
    message = Image(height=height, width=width, encoding=encoding, step=width)
    message.header.stamp.sec = stamp
    message.header.frame_id = "camera_optical_frame"
    message.data = array("B", picture.tobytes())
    return message


def start(processes, **parameters):
    node = processes.start_node("worm_driver", "tracker_node", setup_file=SETUP_FILE, **parameters)
    node.wait_for_line("ready", TIMEOUT_S)
    return node


def send_until(probe, publisher, message, condition, what):
    """Send a sample until it has an effect: a sample without a subscriber is lost."""

    def sent():
        publisher.publish(message)
        probe.wait_for(lambda: True, "turn")
        return condition()

    return probe.wait_for(sent, what)


def test_positions_carry_the_stamps_of_the_images(processes, probe, pictures):
    node = start(processes)
    positions = probe.collect(Tracker, "tracker")
    lengths = probe.collect(BodyLength, "body_length/measured")
    publisher = probe.node.create_publisher(Image, "camera/image_raw", BEST_EFFORT)
    for index, picture in enumerate(pictures):
        stamp = 1000 + index
        send_until(
            probe,
            publisher,
            image_of(picture, stamp),
            lambda stamp=stamp: any(m.header.stamp.sec == stamp for m in positions),
            f"position {index}",
        )
    found = {m.header.stamp.sec: m for m in positions}
    assert [found[1000 + i].rear_position for i in range(3)] == pytest.approx(
        [0.0, 0.001, 0.002], abs=3e-4
    )
    assert math.isnan(found[1003].rear_position)
    assert found[1003].front_position == pytest.approx(LENGTH, abs=3e-4)
    assert {m.header.frame_id for m in [*positions, *lengths]} == {"pipe"}
    assert {m.source for m in lengths} == {BodyLength.MEASURED}
    assert 1003 not in {m.header.stamp.sec for m in lengths}
    node.interrupt()
    assert node.wait(TIMEOUT_S) == 0
