# SPDX-License-Identifier: Apache-2.0
"""Error of the tracker on rendered images of known positions, and its processor time per image."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from benchmarks.report import Row, cpu_time
from tests.helpers.camera_rig import LENGTH, SETTINGS, setup_of
from tests.helpers.rendered_images import CameraSettings, RenderedCamera, axes_of
from worm_driver.tracking.tracker import Tracker
from worm_driver.tracking.vision import MarkerDetector

TITLE = (
    "error of the positions in images of five ridges, and the share of a core at 30 images a second"
)
RATE = 30.0
DURATION, STEP = 12.5, 1.0 / 6.0  # s; every fifth image
ANGLE = math.radians(20.0)
DISTURBED = replace(  # all image defects at once
    SETTINGS,
    noise_dark=2.5,
    noise_bright=4.0,
    light=150.0,
    glare=60.0,
    ridge_transmission=0.88,
    exposure=0.02,
)


def _rig(yaw: float, pitch: float) -> CameraSettings:
    """Return a rig with 0.6 m of pipe in view around a point."""
    settings = replace(DISTURBED, yaw=yaw, pitch_angle=pitch)
    distance = 0.6 * settings.focal / settings.width / math.cos(yaw)
    x, y, z = np.array((0.2, -0.02, 0.0)) - distance * axes_of(settings)[2]
    return replace(settings, position=(float(x), float(y), float(z)))


def _crawling(time: float) -> tuple[float, float]:
    """Return x1 and x2 (m) of a worm that gains five ridges in 12.5 s: a stroke of 70 mm at 0.2 Hz."""
    length = LENGTH - 0.035 * (1.0 - math.cos(2.0 * math.pi * 0.2 * time))
    rear = 5 * 0.0173 * time / DURATION + 0.008 * math.sin(2.0 * math.pi * 0.2 * time)
    return rear, rear + length


def _errors(settings: CameraSettings, times: np.ndarray, seed: int) -> np.ndarray:
    """Return measured minus true positions (m), shape (images, 2); NaN while hidden."""
    camera, tracker = RenderedCamera(settings, seed), Tracker(setup_of(settings))
    detector = MarkerDetector(tracker.setup.dictionary)
    errors = []
    for time in times.tolist():
        seen = tracker.see(detector.detect(camera.moving_image(_crawling, time)), time)
        errors.append(np.subtract((seen.rear, seen.front), _crawling(time)))
    return np.array(errors)


def _accuracy() -> list[Row]:
    views = [
        (0.0, 0.0),
        (ANGLE, 0.0),
        (-ANGLE, 0.0),
        (0.7 * ANGLE, -0.7 * ANGLE),
        (0.0, 0.5 * ANGLE),
    ]
    times = np.arange(0.0, DURATION, STEP)
    errors = 1e3 * np.concatenate(
        [_errors(_rig(*view), times, seed) for seed, view in enumerate(views)]
    )
    seen = np.isfinite(errors)
    how = f"{len(errors)} images from {len(views)} directions up to 20 degrees"
    rms = float(np.sqrt(np.nanmean(errors**2)))
    return [
        Row("error of a position, rms", f"{rms:.3f} mm", "0.1 mm", how),
        Row("error of a position, worst", f"{np.nanmax(np.abs(errors)):.3f} mm", "0.3 mm", how),
        Row("positions that were seen", f"{seen.mean():.1%}", "", how),
    ]


def _cost() -> Row:
    settings = _rig(ANGLE, -0.1)
    image = RenderedCamera(settings, 1).image(*_crawling(1.0))
    tracker = Tracker(setup_of(settings))
    detector = MarkerDetector(tracker.setup.dictionary)
    spent = cpu_time(lambda: tracker.see(detector.detect(image), 1.0), 60)
    return Row(
        "a core's share at 30 images a second",
        f"{spent * RATE:.0%}",
        "50 %",
        f"processor time of {settings.width} x {settings.height} pixels, {spent * 1e3:.1f} ms an image",
    )


def run() -> list[Row]:
    """Measure."""
    return [*_accuracy(), _cost()]
