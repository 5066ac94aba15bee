# SPDX-License-Identifier: Apache-2.0
"""The functions of OpenCV that are used: encodings, corners of markers, dictionaries."""

import numpy as np
import pytest
from camera_rig import SETTINGS, PaperCamera
from rendered_images import MARKERS, RenderedCamera, framed

from worm_driver.driver_errors import ImageError
from worm_driver.tracking import vision

RAMP = np.tile(np.arange(0, 240, 4, dtype=np.uint8), (8, 1))
HEIGHT, WIDTH = RAMP.shape


def encoded(encoding: str) -> np.ndarray:
    """Return the grey ramp in an encoding."""
    if encoding == "mono8":
        return RAMP
    if encoding in ("yuv422", "uyvy", "yuv422_yuy2", "yuyv"):
        colour = np.full_like(RAMP, 128)
        order = (colour, RAMP) if encoding in ("yuv422", "uyvy") else (RAMP, colour)
        return np.stack(order, axis=2).reshape(HEIGHT, -1)
    return np.repeat(RAMP[:, :, None], 3, axis=2).reshape(HEIGHT, -1)


@pytest.mark.parametrize(
    "encoding", ["mono8", "bgr8", "rgb8", "yuv422", "uyvy", "yuv422_yuy2", "yuyv"]
)
@pytest.mark.parametrize("padding", [0, 5])
def test_every_encoding_gives_the_same_grey(encoding: str, padding: int):
    rows = np.pad(encoded(encoding), ((0, 0), (0, padding)), constant_values=99)
    image = vision.grey(rows.ravel(), HEIGHT, WIDTH, rows.shape[1], encoding)
    assert image.shape == RAMP.shape
    assert image == pytest.approx(RAMP, abs=1)


def test_red_green_and_blue_are_not_mixed_up():
    pixel = np.array([10, 100, 200], np.uint8)
    grey = round(0.114 * 10 + 0.587 * 100 + 0.299 * 200)
    assert vision.grey(pixel, 1, 1, 3, "bgr8") == grey
    assert vision.grey(pixel[::-1], 1, 1, 3, "rgb8") == grey


def test_other_encodings_are_rejected_by_name():
    with pytest.raises(
        ImageError, match="'bayer_rggb8' are not supported: set the camera to one of mono8"
    ):
        vision.grey(RAMP.ravel(), HEIGHT, WIDTH, WIDTH, "bayer_rggb8")
    with pytest.raises(ImageError, match="479 bytes"):
        vision.grey(RAMP.ravel()[:-1], HEIGHT, WIDTH, WIDTH, "mono8")


def test_the_rendered_prints_are_those_of_the_dictionary():
    for number, rows in MARKERS.items():
        printed = vision.marker_image("DICT_4X4_50", number, 1)
        assert np.array_equal(framed(rows)[1:-1, 1:-1] > 0.5, printed > 0)


def test_corners_are_where_an_independent_camera_has_them():
    image = RenderedCamera(SETTINGS, 2).image(0.02, 0.31)
    found = {d.number: d for d in vision.MarkerDetector("DICT_4X4_50").detect(image)}
    paper = PaperCamera()
    for truth in [*paper.references(), *paper.modules(0.02, 0.31)]:
        wrong = found[truth.number].corners - truth.corners
        assert np.abs(wrong).max() < 0.2  # pixels, each corner
        assert np.abs(wrong.mean(axis=0)).max() < 0.08  # and their mean
        assert found[truth.number].edge_width < 0.5


def test_the_width_of_edges_measures_their_blur():
    """A ramp of w cells has 0.8 w from 10 to 90 %."""
    cells, pixels = framed(MARKERS[0]), 12
    sharp = np.kron(np.pad(cells, 2, constant_values=1.0), np.ones((pixels, pixels))) * 200
    detector = vision.MarkerDetector("DICT_4X4_50")
    for ramp in (0.25, 0.5, 1.0):
        box = np.ones(round(ramp * pixels)) / round(ramp * pixels)
        blurred = np.apply_along_axis(np.convolve, 1, sharp, box, mode="same")
        (found,) = detector.detect(blurred.astype(np.uint8))
        assert found.edge_width == pytest.approx(0.8 * ramp, rel=0.2, abs=0.05)


@pytest.mark.parametrize("dictionary", ["DICT_5X5_100", "DICT_APRILTAG_36h11", "DICT_6X6_250"])
def test_other_dictionaries(dictionary):
    printed = vision.marker_image(dictionary, 7, 9)
    image = np.pad(printed // 2 + 60, 18, constant_values=187)
    (found,) = vision.MarkerDetector(dictionary).detect(image)
    assert found.number == 7
    assert found.corners[0] == pytest.approx([17.5, 17.5], abs=0.1)
    assert found.corners[2] == pytest.approx([17.5 + len(printed)] * 2, abs=0.1)
