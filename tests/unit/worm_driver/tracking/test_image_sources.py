# SPDX-License-Identifier: Apache-2.0
"""Images from folders, with their times."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from worm_driver.driver_errors import ImageError
from worm_driver.tracking.image_sources import (
    frames_of_folder,
    frames_of_video,
    times_of_folder,
)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for number in (1, 2, 9, 10):
        cv2.imwrite(str(tmp_path / f"image_{number}.png"), np.full((4, 6), number, np.uint8))
    return tmp_path


def test_names_are_in_the_order_of_their_numbers(folder: Path):
    frames = list(frames_of_folder(folder, 25.0))
    assert [frame.name for frame in frames] == [f"image_{n}.png" for n in (1, 2, 9, 10)]
    assert [frame.time for frame in frames] == pytest.approx([0.0, 0.04, 0.08, 0.12])
    assert [int(frame.image[0, 0]) for frame in frames] == [1, 2, 9, 10]


def test_times_come_from_the_table(folder: Path):
    (folder / "times.csv").write_text("file,time_s\nimage_9.png,2.5\nimage_1.png,2.75\n")
    frames = list(frames_of_folder(folder, 0.0))
    assert [(frame.name, frame.time) for frame in frames] == [
        ("image_9.png", 2.5),
        ("image_1.png", 2.75),
    ]


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ("name,time\n", "must name the columns file,time_s"),
        ("file,time_s\n", "has no rows"),
        ("file,time_s\nimage_1.png,1\nimage_2.png,1\n", "line 3: time_s"),
        ("file,time_s\nimage_1.png,x\n", "line 2: time_s is 'x', not a number"),
        ("file,time_s\nimage_1.png\n", "time_s is None"),
        ("file,time_s\nimage_3.png,1\n", "there is no file 'image_3.png'"),
        ("file,time_s\n,1\n", "there is no file ''"),
    ],
)
def test_a_wrong_table_is_rejected(folder: Path, table: str, message: str):
    (folder / "times.csv").write_text(table)
    with pytest.raises(ImageError, match=message):
        times_of_folder(folder, 30.0)


def test_without_times_or_images_nothing_is_guessed(folder: Path, tmp_path_factory):
    with pytest.raises(ImageError, match=r"add times.csv .* or rate_hz"):
        times_of_folder(folder, 0.0)
    with pytest.raises(ImageError, match="no images"):
        times_of_folder(tmp_path_factory.mktemp("empty"), 30.0)
    with pytest.raises(ImageError, match="is not a folder"):
        times_of_folder(folder / "image_1.png", 30.0)
    (folder / "image_2.png").write_bytes(b"no image")
    with pytest.raises(ImageError, match=r"image_2.png cannot be read"):
        list(frames_of_folder(folder, 30.0))


def test_a_file_that_is_no_film_is_rejected(folder: Path):
    with pytest.raises(ImageError, match="is not a file"):
        next(frames_of_video(folder, 30.0))
    (folder / "video.mp4").write_bytes(b"no video")
    with pytest.raises(ImageError, match="is it a video"):
        next(frames_of_video(folder / "video.mp4", 30.0))
