# SPDX-License-Identifier: Apache-2.0
"""Image sequences with times, from a folder, a video or a camera, and the thread that reads a camera."""

import csv
import math
import re
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from worm_driver.driver_errors import ImageError
from worm_driver.tracking.vision import Image, VideoSource, read_image

TIMES_FILE = "times.csv"
IMAGE_ENDINGS = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".pgm")


@dataclass(frozen=True)
class Frame:
    """Grey image with its name in the source and its time (s)."""

    name: str
    time: float
    image: Image


def frames_of_folder(folder: Path, rate: float) -> Iterator[Frame]:
    """Yield the images of a folder in the order and at the times of its times.csv (columns file,time_s).

    Without this file, yield them sorted by name at a rate (Hz).
    """
    for path, at in times_of_folder(folder, rate):
        yield Frame(path.name, at, read_image(path))


def times_of_folder(folder: Path, rate: float) -> list[tuple[Path, float]]:
    """Return the image files of a folder with their times (s). Raises ImageError as `frames_of_folder` does."""
    if not folder.is_dir():
        raise ImageError(f"{folder} is not a folder")
    if (folder / TIMES_FILE).exists():
        return _listed(folder / TIMES_FILE)
    paths = sorted(
        (path for path in folder.iterdir() if path.suffix.lower() in IMAGE_ENDINGS), key=_natural
    )
    if not paths:
        raise ImageError(f"{folder} contains no images ({', '.join(IMAGE_ENDINGS)})")
    if not rate > 0.0:
        raise ImageError(
            f"the times of the images in {folder} are unknown: add {TIMES_FILE} (file,time_s), or rate_hz to the "
            "setup file"
        )
    return [(path, index / rate) for index, path in enumerate(paths)]


def _natural(path: Path) -> list[tuple[int, str]]:
    """Return a sort key that puts image_10 after image_9."""
    parts = re.findall(r"\d+|\D+", path.name)
    return [(int(part), "") if part.isdigit() else (-1, part) for part in parts]


def _listed(path: Path) -> list[tuple[Path, float]]:
    frames: list[tuple[Path, float]] = []
    before = -math.inf
    try:
        with path.open(encoding="utf-8-sig", newline="") as stream:
            reader = csv.DictReader(stream)
            if not {"file", "time_s"} <= set(reader.fieldnames or ()):
                raise ImageError(f"{path}: the first line must name the columns file,time_s")
            for row in reader:
                place = f"{path}, line {reader.line_num}"
                time = _time(row["time_s"], place)
                if not time > before:
                    raise ImageError(f"{place}: time_s does not increase")
                if not row["file"] or not (path.parent / row["file"]).is_file():
                    raise ImageError(f"{place}: there is no file {row['file']!r}")
                frames.append((path.parent / row["file"], time))
                before = time
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise ImageError(f"{path} cannot be read: {error}") from None
    if not frames:
        raise ImageError(f"{path} has no rows")
    return frames


def _time(text: str | None, place: str) -> float:
    try:
        time = float(text or "")
    except ValueError:
        time = math.nan
    if not math.isfinite(time):
        raise ImageError(f"{place}: time_s is {text!r}, not a number")
    return time


def frames_of_video(path: Path, rate: float) -> Iterator[Frame]:
    """Yield the images of a video at the times stored in it.

    If the video contains no times, the images are spaced by the frame rate stored in the video. If the video contains
    no frame rate either, they are spaced by ``rate`` (Hz).
    """
    if not path.is_file():
        raise ImageError(f"{path} is not a file")
    with closing(VideoSource(str(path))) as video:
        rate = video.rate if 0.0 < video.rate < 1000.0 else rate
        if not rate > 0.0:
            raise ImageError(f"{path} contains no frame rate: add rate_hz to the setup file")
        before = -math.inf
        for index, (image, stored) in enumerate(video.images()):
            # Some containers store no times, or the same time for all images. Such images are spaced equally.
            before = stored if stored > before else before + 1.0 / rate
            yield Frame(f"image {index}", before, image)
    if before == -math.inf:
        raise ImageError(f"{path} contains no readable images")


def check_size(image: Image, size: tuple[int, int], name: str) -> None:
    """Raise ImageError unless an image has the size (width, height) that the camera was calibrated for."""
    height, width = image.shape
    if (width, height) != size:
        raise ImageError(
            f"{name} has {width} x {height} pixels, but camera_info is for {size[0]} x {size[1]}: "
            "calibrate at the recorded image size"
        )


_QUEUE_LENGTH = 2  # images; the oldest image is dropped if the tracker is late


class CameraThread(threading.Thread):
    """Thread that reads a V4L2 camera and stamps each image with its arrival on the monotonic clock (s).

    Args:
        device: device of the camera, such as /dev/video0.
        size: (width, height) requested from the camera, pixels.
        rate: rate requested from the camera, Hz; 0 for the default.
        arrived: called in the thread when an image is available or the camera has failed.

    Attributes:
        failure: error that ended the images; None without an error.
    """

    def __init__(
        self, device: str, size: tuple[int, int], rate: float, arrived: Callable[[], None]
    ):
        super().__init__(name="images", daemon=True)
        self._device, self._size, self._rate = device, size, rate
        self._arrived = arrived
        self._queue: deque[Frame] = deque(maxlen=_QUEUE_LENGTH)
        self._closed = False
        self.failure: ImageError | None = None

    def next_frame(self) -> Frame | None:
        """Return the next image, None if the queue is empty."""
        return self._queue.popleft() if self._queue else None

    def close(self) -> None:
        """Stop the thread, which closes the camera."""
        self._closed = True
        self.join(timeout=1.0)

    def run(self) -> None:
        """Read the camera until `close` is called or the camera fails."""
        try:
            with closing(VideoSource(self._device)) as camera:
                camera.request_format(*self._size, self._rate)
                for image, _ in camera.images():
                    if self._closed:
                        return
                    self._queue.append(Frame(self._device, time.monotonic(), image))
                    self._arrived()
            raise ImageError(f"{self._device} delivers no more images: was it unplugged?")
        except ImageError as error:
            self.failure = error
            self._arrived()
