# SPDX-License-Identifier: Apache-2.0
"""Error of the tracker on rendered images of known positions, and its processor time per image."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from benchmarks.report import Row, cpu_time
from worm_driver.tracking.camera_model import CameraModel
from worm_driver.tracking.tracker import Tracker
from worm_driver.tracking.tracker_setup import ModuleLine, ModuleMarker, TrackerSetup
from worm_driver.tracking.vision import MarkerDetector
from worm_driver.virtual_robot.camera_images import (
    CameraSettings,
    VirtualCamera,
    exposure_path,
    load_camera_settings,
)

TITLE = (
    "error of the positions in images of five ridges, and the share of a core at 30 images a second"
)
RATE = 30.0
DURATION, STEP = 12.5, 1.0 / 6.0  # s; every fifth image
ANGLE = math.radians(20.0)


def _rig(yaw: float, pitch: float) -> CameraSettings:
    """Return a rig with 0.6 m of pipe in view and all image defects at once."""
    s = replace(load_camera_settings(), yaw=yaw, pitch_angle=pitch)
    distance = 0.6 * s.focal / s.width / math.cos(yaw)
    forward = np.array(
        [-math.sin(yaw) * math.cos(pitch), math.cos(yaw) * math.cos(pitch), math.sin(pitch)]
    )
    x, y, z = np.array([0.2, -0.02, 0.0]) - distance * forward
    return replace(
        s,
        position=(float(x), float(y), float(z)),
        noise_dark=2.5,
        noise_bright=4.0,
        light=150.0,
        glare=60.0,
        ridge_transmission=0.88,
        exposure=0.02,
    )


def _tracker(s: CameraSettings) -> Tracker:
    model = CameraModel(s.width, s.height, (s.focal, s.focal), s.centre, "plumb_bob", s.distortion)
    rear, front = ModuleMarker(s.rear.marker, 0.0), ModuleMarker(s.front.marker, 0.0)
    return Tracker(
        TrackerSetup(
            dictionary="DICT_4X4_50",
            marker_size=s.marker_size,
            rear=rear,
            front=front,
            line=ModuleLine(*s.module_line),
            reference=s.reference,
            camera=model,
        )
    )


def _places(time: float) -> tuple[float, float]:
    angle = 2.0 * math.pi * 0.2 * time
    rear = 5 * 0.0173 * time / DURATION + 0.008 * math.sin(angle)
    return rear, rear + 0.2952 - 0.035 * (1.0 - math.cos(angle))


def _errors(settings: CameraSettings, seed: int) -> np.ndarray:
    """Return measured minus true positions in mm, shape (images, 2)."""
    camera, tracker = VirtualCamera(settings, seed), _tracker(settings)
    detector = MarkerDetector(tracker.setup.dictionary)
    errors = []
    for time in np.arange(0.0, DURATION, STEP):
        before, now = ((round(t * 1e9), *_places(t)) for t in (float(time) - 1e-3, float(time)))
        image = camera.image(exposure_path(now, before, settings.exposure))
        seen = tracker.see(detector.detect(image), float(time))
        errors.append((seen.rear - now[1], seen.front - now[2]))
    return 1e3 * np.array(errors)


def _accuracy() -> list[Row]:
    views = [
        (0.0, 0.0),
        (ANGLE, 0.0),
        (-ANGLE, 0.0),
        (0.7 * ANGLE, -0.7 * ANGLE),
        (0.0, 0.5 * ANGLE),
    ]
    errors = np.concatenate([_errors(_rig(*view), seed) for seed, view in enumerate(views)])
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
    image = VirtualCamera(settings, 1).image(np.array([_places(1.0)]))
    tracker = _tracker(settings)
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
