# SPDX-License-Identifier: Apache-2.0
"""Rows on the camera, from rendered images that arrive at the times of a camera."""

import time

import numpy as np
import pytest
from camera_rig import LENGTH, SETTINGS, setup_of
from rendered_images import RenderedCamera

from worm_driver.driver_errors import ImageError
from worm_driver.tracking import camera_check
from worm_driver.tracking.tracker import Tracker

ROWS = list(camera_check.CAMERA_ROWS)


@pytest.fixture(scope="module")
def image() -> np.ndarray:
    return RenderedCamera(SETTINGS, 3).image(0.0, LENGTH)


class Camera:
    """Camera whose images arrive ``period`` s apart, each ``delay`` s after its exposure; the clock is its own."""

    image: np.ndarray
    period, delay, left = 1 / 30, 0.010, 100

    def __init__(self, _: str):
        self.now = 100.0

    def request_format(self, *_: object) -> None:
        pass

    def images(self):
        for _ in range(self.left):
            self.now += self.period
            Camera.arrival = self.now
            yield self.image, self.now - self.delay

    def close(self) -> None:
        pass


def states(monkeypatch, image, setup=None, **values: object) -> dict[str, tuple[str, str]]:
    kind = type("Changed", (Camera,), {"image": image, **values})
    monkeypatch.setattr(camera_check, "VideoSource", kind)
    monkeypatch.setattr(time, "monotonic", lambda: Camera.arrival)
    tracker = Tracker(setup or setup_of(SETTINGS, rate=30.0))
    rows = camera_check.camera_rows(tracker, "/dev/video0")
    assert [row.name for row in rows] == ROWS
    return {row.name: (row.state.value, row.found + row.remedy) for row in rows}


def test_a_good_camera_is_green(monkeypatch, image):
    rows = states(monkeypatch, image)
    assert [state for state, _ in rows.values()] == ["ok"] * 3
    assert "30.0 Hz" in rows["camera rate"][1]
    assert "10 ms" in rows["camera delay"][1]


@pytest.mark.parametrize(
    ("values", "name", "text"),
    [
        ({"period": 0.1}, "camera rate", "10.0 Hz instead of rate_hz 30"),
        ({"delay": 0.060}, "camera delay", "to 0.060"),
        ({"image": np.zeros((SETTINGS.height, SETTINGS.width), np.uint8)}, "markers", "view"),
    ],
)
def test_a_fault_turns_one_row(monkeypatch, image, values, name, text):
    rows = states(monkeypatch, **{"image": image, **values})
    assert {row: state for row, (state, _) in rows.items() if state != "ok"} == {name: "warning"}
    assert text in rows[name][1]


def test_a_camera_with_another_clock_or_the_right_delay_is_green(monkeypatch, image):
    rows = states(monkeypatch, image, delay=1e6)
    assert rows["camera delay"][0] == "ok"
    assert "not measured" in rows["camera delay"][1]
    rows = states(monkeypatch, image, setup_of(SETTINGS, delay=0.060), delay=0.060)
    assert rows["camera delay"][0] == "ok"


def test_a_camera_without_usable_images_fails_one_row(monkeypatch, image):
    def absent(_: object, source: str) -> None:
        raise ImageError(f"{source} cannot be opened: is it connected?")

    for values in ({"__init__": absent}, {"left": 5}, {"image": image[:100]}):
        rows = states(monkeypatch, **{"image": image, **values})
        assert [state for state, _ in rows.values()] == ["failed", "skipped", "skipped"]
