# SPDX-License-Identifier: Apache-2.0
"""tracker_node as a process: images over DDS in, positions out."""

import math
from array import array

import numpy as np
import pytest
from camera_rig import LENGTH, SETTINGS, SETUP_FILE
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from harness import TIMEOUT_S
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rendered_images import RenderedCamera
from sensor_msgs.msg import CompressedImage, Image

from worm_driver.tracking.vision import write_image
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


def test_compressed_images_and_refusals_by_name(processes, probe, pictures, tmp_path):
    start(processes, image_transport="compressed")
    positions = probe.collect(Tracker, "tracker")
    reported = probe.collect(DiagnosticArray, "/diagnostics")
    topic = "camera/image_raw/compressed"
    publisher = probe.node.create_publisher(CompressedImage, topic, 5)
    wrong = CompressedImage(format="jpeg", data=array("B", b"no image"))

    def rejected():
        return any(
            s.level == DiagnosticStatus.ERROR and "8 bytes" in s.message
            for m in reported
            for s in m.status
        )

    send_until(probe, publisher, wrong, rejected, "refusal")
    write_image(tmp_path / "picture.jpg", pictures[1])
    good = CompressedImage(format="jpeg", data=array("B", (tmp_path / "picture.jpg").read_bytes()))
    send_until(probe, publisher, good, lambda: positions, "position")
    assert positions[-1].rear_position == pytest.approx(0.001, abs=4e-4)


def test_a_folder_of_images_is_played(processes, probe, pictures, tmp_path):
    for index, picture in enumerate([pictures[2]] * 200):
        if index == 0:
            write_image(tmp_path / "0.png", picture)
        else:
            (tmp_path / f"{index}.png").symlink_to(tmp_path / "0.png")
    times = "".join(f"{index}.png,{0.1 * index}\n" for index in range(200))
    (tmp_path / "times.csv").write_text("file,time_s\n" + times)
    positions = probe.collect(Tracker, "tracker")
    start(processes, source=str(tmp_path))
    probe.wait_for(lambda: len(positions) >= 5, "positions")
    stamps = [m.header.stamp.sec + m.header.stamp.nanosec * 1e-9 for m in positions]
    steps = np.diff(stamps) / 0.1
    assert steps == pytest.approx(np.round(steps), abs=0.05)  # images are dropped, never shifted
    assert positions[-1].rear_position == pytest.approx(0.002, abs=3e-4)
