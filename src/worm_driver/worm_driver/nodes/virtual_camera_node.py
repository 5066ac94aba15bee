# SPDX-License-Identifier: Apache-2.0
"""Node ``virtual_camera``, which renders and publishes the images of a camera next to the pipe of the virtual robot.

virtual_robot starts the node as a separate process, because rendering an image takes longer than an answer on the servo
bus may take. Each line of standard input is an exposure: stamp in ns, x1 and x2 in m, nan while a marker is hidden.
The first line of standard output reports that the node is ready. Each further line reports that an image was published
or lost, so that the virtual time can wait for the camera.
"""

import contextlib
import os
import select
import subprocess
import sys
import threading
import time
from array import array
from collections import deque
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from builtin_interfaces.msg import Time
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.utilities import remove_ros_args
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import Header

from worm_driver.virtual_robot.camera_images import (
    CameraSettings,
    VirtualCamera,
    exposure_path,
    load_camera_settings,
)
from worm_msgs.command_parser import Parser
from worm_msgs.ros_process import ros_process

#: frame of the images (REP 103): z forward, x to the right
FRAME = "camera_optical_frame"
_NANOSECONDS = 10**9
_CHUNK = 4096  # bytes that are read at once
_END_TIMEOUT = 3.0  # s, longest wait for the end of the process after its input was closed


class VirtualCameraNode(Node):
    """Publisher of an image for each exposure. Two exposures may wait; a further one replaces the oldest."""

    def __init__(self, settings: CameraSettings, seed: int) -> None:
        super().__init__("virtual_camera")
        self._settings = settings
        self._camera = VirtualCamera(settings, seed)
        self._image = self.create_publisher(Image, "camera/image_raw", 2)
        self._info = self.create_publisher(CameraInfo, "camera/camera_info", 2)
        self._waiting: deque[tuple[int, float, float]] = deque(maxlen=2)
        self._before: tuple[int, float, float] | None = None
        self._arrival = self.create_guard_condition(self._publish)
        self.ended = False

    def read(self) -> None:
        """Read exposures from standard input until it is closed. Runs in its own thread."""
        for line in sys.stdin:
            stamp, rear, front = line.split()
            if len(self._waiting) == self._waiting.maxlen:
                _report("lost")
            self._waiting.append((int(stamp), float(rear), float(front)))
            self._arrival.trigger()
        self.ended = True

    def _publish(self) -> None:
        while self._waiting:
            exposure = self._waiting.popleft()
            path = exposure_path(exposure, self._before, self._settings.exposure)
            self._before = exposure
            header = _header(exposure[0] + round(self._settings.delay * _NANOSECONDS))
            self._image.publish(_message(self._camera.image(path), header))
            self._info.publish(_info(self._settings, header))
            _report("published")


def _report(event: str) -> None:
    sys.stdout.write(f"{event}\n")
    sys.stdout.flush()


def _header(stamp: int) -> Header:
    time = Time(sec=stamp // _NANOSECONDS, nanosec=stamp % _NANOSECONDS)
    return Header(stamp=time, frame_id=FRAME)


def _message(image: np.ndarray, header: Header) -> Image:
    height, width = image.shape
    message = Image(header=header, height=height, width=width, encoding="mono8", step=width)
    message.data = array("B", image.tobytes())
    return message


def _info(settings: CameraSettings, header: Header) -> CameraInfo:
    f, (cx, cy) = settings.focal, settings.centre
    return CameraInfo(
        header=header,
        height=settings.height,
        width=settings.width,
        distortion_model="plumb_bob",
        d=list(settings.distortion),
        k=[f, 0.0, cx, 0.0, f, cy, 0.0, 0.0, 1.0],
        r=[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        p=[f, 0.0, cx, 0.0, 0.0, f, cy, 0.0, 0.0, 0.0, 1.0, 0.0],
    )


class CameraProcess:
    """Process of the node, started by virtual_robot.

    Args:
        file: settings of the camera.
        seed: seed of the sensor noise.
        namespace: namespace of the node.
    """

    def __init__(self, file: Path, seed: int, namespace: str) -> None:
        command = [sys.executable, "-m", __name__, "--parameters", str(file), "--seed", str(seed)]
        command += ["--ros-args", "-r", f"__ns:={namespace}"]
        # The process has its own session, so that Ctrl-C does not reach it: the virtual robot ends the process.
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True
        )
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._input = self._process.stdin
        self._process.stdout.readline()  # The process is ready, or has ended.
        os.set_blocking(self._input.fileno(), False)
        self._output = self._process.stdout.fileno()
        self._ahead = 0  # number of exposures that are neither published nor lost yet

    def expose(self, stamp: int, rear: float, front: float, timeout: float) -> None:
        """Send an exposure. First wait until all earlier exposures are published or lost, at most for the timeout.

        If the process is too slow, an exposure is lost: the oldest that waits, or this one if the pipe is full.

        Args:
            stamp: time of the exposure, ns.
            rear, front: x1 and x2, m; NaN while a marker is hidden.
            timeout: longest wait, s.

        Raises:
            ChildProcessError: The process has ended.
        """
        self._wait_for_images(timeout)
        line = f"{stamp} {rear!r} {front!r}\n".encode()
        try:
            os.write(self._input.fileno(), line)
            self._ahead += 1
        except BlockingIOError:
            return  # The process is far behind; this exposure is lost.
        except BrokenPipeError:
            raise ChildProcessError(
                "the virtual camera has ended; see its messages above"
            ) from None

    def _wait_for_images(self, timeout: float) -> None:
        end = time.monotonic() + timeout
        while select.select(
            [self._output], [], [], max(end - time.monotonic(), 0.0) if self._ahead else 0.0
        )[0]:
            chunk = os.read(self._output, _CHUNK)
            self._ahead = max(self._ahead - chunk.count(b"\n"), 0)
            if not chunk or not self._ahead:
                return

    def close(self) -> None:
        """End the process."""
        with contextlib.suppress(BrokenPipeError):
            self._input.close()
        try:
            self._process.wait(_END_TIMEOUT)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


def main(arguments: Sequence[str] | None = None) -> int:
    """Run until standard input is closed or a signal arrives. Return the exit status."""
    command_line = sys.argv if arguments is None else ["virtual_camera", *arguments]
    parser = Parser(prog="virtual_camera", description=__doc__)
    parser.add_argument("--parameters", type=Path, metavar="FILE")
    parser.add_argument("--seed", type=int, default=0, metavar="N")
    options = parser.parse_args(remove_ros_args(command_line)[1:])
    settings = load_camera_settings(options.parameters)
    with ros_process(command_line) as ended:
        node = VirtualCameraNode(settings, options.seed)
        threading.Thread(target=node.read, name="exposures", daemon=True).start()
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        _report("ready")
        while not (ended() or node.ended):
            executor.spin_once(timeout_sec=0.1)
        node.destroy_node()
    return 0


if __name__ == "__main__":
    sys.exit(main())
