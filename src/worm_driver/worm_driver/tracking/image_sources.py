# SPDX-License-Identifier: Apache-2.0
"""Image sequences with times, read from a folder or a video file."""

import csv
import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from worm_driver.tracking.tracking_errors import ImageError
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

    Raises:
        ImageError: The folder has no images, an image cannot be read, or the times are unknown.
    """
    for path, time in times_of_folder(folder, rate):
        yield Frame(path.name, time, read_image(path))


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

    Raises:
        ImageError: The video cannot be opened or has no images, or no frame rate is known (even if times are stored).
    """
    if not path.is_file():
        raise ImageError(f"{path} is not a file")
    video = VideoSource(str(path))
    try:
        rate = video.rate if 0.0 < video.rate < 1000.0 else rate
        if not rate > 0.0:
            raise ImageError(f"{path} contains no frame rate: add rate_hz to the setup file")
        before = -math.inf
        index = 0
        while (image_and_time := video.read()) is not None:
            image, time = image_and_time
            # Some containers store no times, or the same time for all images. Such images are spaced equally.
            time = time if time > before else (index / rate if index == 0 else before + 1.0 / rate)
            yield Frame(f"image {index}", time, image)
            before = time
            index += 1
        if index == 0:
            raise ImageError(f"{path} contains no readable images")
    finally:
        video.close()


def check_size(image: Image, size: tuple[int, int], name: str) -> None:
    """Raise ImageError unless an image has the size (width, height) that the camera was calibrated for."""
    height, width = image.shape
    if (width, height) != size:
        raise ImageError(
            f"{name} has {width} x {height} pixels, but camera_info is for {size[0]} x {size[1]}: "
            "calibrate at the recorded image size"
        )
