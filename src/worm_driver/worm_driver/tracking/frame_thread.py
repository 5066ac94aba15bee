# SPDX-License-Identifier: Apache-2.0
"""Images of a camera, a film or a folder as they come in time, from a thread that waits for them."""

import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path

from worm_driver.tracking.image_sources import Frame, frames_of_film, frames_of_folder
from worm_driver.tracking.tracker_setup import TrackerSetup
from worm_driver.tracking.tracking_errors import ImageError, TrackingError
from worm_driver.tracking.vision import Film

_WAITING = 2  # images that may wait; a tracker that is late drops the older ones
_PATIENCE = 0.05  # s, in which the end is noticed


def frames_of_device(device: str, size: tuple[int, int], rate: float) -> Iterator[Frame]:
    """The images of a V4L2 camera, without end; their time is that of their arrival on the monotonic clock (s).

    Raises ImageError: it cannot be opened, or gives no more images.
    """
    camera = Film(device)
    try:
        camera.ask_for(*size, rate)
        while (taken := camera.read()) is not None:
            yield Frame(device, time.monotonic(), taken[0])
        raise ImageError(f"{device} gives no more images: was it unplugged?")
    finally:
        camera.close()


class FrameThread:
    """Hands images over in their own time.

    Args:
        source: a device under /dev, a film, or a folder.
        setup: the rig, for the rate of a folder and of a device.
        size: (width, height) that a camera is asked for.
        arrived: called in the thread when an image, or the end, is there to be taken.
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
            self._frames = frames_of_film(Path(source), setup.rate)
        self._arrived = arrived
        self._waiting: deque[Frame] = deque(maxlen=_WAITING)
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._run, name="images", daemon=True)
        self.ended = False
        self.failure: TrackingError | None = None

    def start(self) -> None:
        """Begins."""
        self._thread.start()

    def take(self) -> Frame | None:
        """The next image, its time on the monotonic clock (s); None if there is none."""
        return self._waiting.popleft() if self._waiting else None

    def close(self) -> None:
        """Ends the thread."""
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
                        self._ending.wait(min(due - time.monotonic(), _PATIENCE))
                if self._ending.is_set():
                    return
                self._waiting.append(Frame(frame.name, due, frame.image))
                self._arrived()
        except TrackingError as error:
            self.failure = error
        self.ended = True
        self._arrived()
