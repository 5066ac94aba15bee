# SPDX-License-Identifier: Apache-2.0
"""Thread that reads images from a camera, a video or a folder at their times."""

import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path

from worm_driver.tracking.image_sources import Frame, frames_of_folder, frames_of_video
from worm_driver.tracking.tracker_setup import TrackerSetup
from worm_driver.tracking.tracking_errors import ImageError, TrackingError
from worm_driver.tracking.vision import VideoSource

_QUEUE_LENGTH = 2  # images; the oldest image is dropped if the tracker is late
_POLL_PERIOD = 0.05  # s, longest single wait for the time of an image


def frames_of_device(device: str, size: tuple[int, int], rate: float) -> Iterator[Frame]:
    """Yield the images of a V4L2 camera, stamped with their arrival on the monotonic clock (s).

    Raises:
        ImageError: The camera cannot be opened, or delivers no more images.
    """
    camera = VideoSource(device)
    try:
        camera.request_format(*size, rate)
        while (image_and_time := camera.read()) is not None:
            yield Frame(device, time.monotonic(), image_and_time[0])
        raise ImageError(f"{device} delivers no more images: was it unplugged?")
    finally:
        camera.close()


class FrameThread:
    """Thread that reads images, and delivers those of a video or a folder at their times.

    Args:
        source: a device under /dev, a video, or a folder of images.
        setup: setup of the tracker, of which only the rate is used (`Rig.rate`).
        size: (width, height) requested from a camera, pixels.
        arrived: called in the thread when an image is available or the source has ended.

    Attributes:
        ended: True if the source has ended or failed.
        failure: error that ended the source; None without an error.
    """

    def __init__(
        self, source: str, setup: TrackerSetup, size: tuple[int, int], arrived: Callable[[], None]
    ):
        self._live = source.startswith("/dev/")
        if self._live:
            self._frames = frames_of_device(source, size, setup.rate)
        elif Path(source).is_dir():
            self._frames = frames_of_folder(Path(source), setup.rate)
        else:
            self._frames = frames_of_video(Path(source), setup.rate)
        self._arrived = arrived
        self._queue: deque[Frame] = deque(maxlen=_QUEUE_LENGTH)
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._run, name="images", daemon=True)
        self.ended = False
        self.failure: TrackingError | None = None

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def next_frame(self) -> Frame | None:
        """Return the next image with its time on the monotonic clock (s), None if the queue is empty."""
        return self._queue.popleft() if self._queue else None

    def close(self) -> None:
        """Stop the thread."""
        self._ending.set()
        self._thread.join(timeout=1.0)

    def _run(self) -> None:
        begin: float | None = None
        try:
            for frame in self._frames:
                due = frame.time
                if not self._live:
                    begin = time.monotonic() - frame.time if begin is None else begin
                    due = begin + frame.time
                    while time.monotonic() < due and not self._ending.is_set():
                        self._ending.wait(min(due - time.monotonic(), _POLL_PERIOD))
                if self._ending.is_set():
                    return
                self._queue.append(Frame(frame.name, due, frame.image))
                self._arrived()
        except TrackingError as error:
            self.failure = error
        self.ended = True
        self._arrived()
