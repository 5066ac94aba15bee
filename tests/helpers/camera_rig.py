# SPDX-License-Identifier: Apache-2.0
"""Rigs before a rendered camera: images of known positions, and the tracker's results for them."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rendered_images import CameraSettings, RenderedCamera, axes_of, pixels_of

from worm_driver.tracking.camera_model import CameraModel
from worm_driver.tracking.tracker import TrackedPositions, Tracker
from worm_driver.tracking.tracker_setup import ModuleLine, TrackerSetup, load_setup
from worm_driver.tracking.vision import Detection, MarkerDetector

Array = NDArray[np.float64]
SETTINGS = CameraSettings()
SETUP_FILE = Path(__file__).with_name("tracker.yaml")  # the same rig, as the tracker reads it
LENGTH = 0.2952
RIDGES = 5
PITCH = 0.0173


def looking_at(settings: CameraSettings, place: tuple[float, float, float]) -> CameraSettings:
    """Return a camera whose image width shows 0.6 m of the pipe around a point."""
    distance = 0.6 * settings.focal / settings.width / math.cos(settings.yaw)
    x, y, z = np.array(place) - distance * axes_of(settings)[2]
    return replace(settings, position=(float(x), float(y), float(z)))


def model_of(settings: CameraSettings) -> CameraModel:
    """Return the calibration of a camera."""
    focal = (settings.focal, settings.focal)
    size = settings.width, settings.height
    return CameraModel(size, focal, settings.centre, "plumb_bob", settings.distortion)


def setup_of(settings: CameraSettings, **changes: object) -> TrackerSetup:
    """Return the setup that a lab would write for a rig before the camera of `SETTINGS`."""
    own = {"marker_size": settings.marker_size, "line": ModuleLine(*settings.module_line)}
    setup = replace(load_setup(SETUP_FILE), reference=settings.reference, **own)
    return replace(setup, **changes)  # type: ignore[arg-type]


def crawling(time: float) -> tuple[float, float]:
    """Return x1 and x2 (m) of a worm that gains five ridges in 12.5 s: a stroke of 70 mm at 0.2 Hz."""
    length = LENGTH - 0.035 * (1.0 - math.cos(2.0 * math.pi * 0.2 * time))
    rear = RIDGES * PITCH * time / 12.5 + 0.008 * math.sin(2.0 * math.pi * 0.2 * time)
    return rear, rear + length


@dataclass(frozen=True)
class VideoSource:
    """True positions (m), shape (images, 2), and the tracker's results."""

    truth: Array
    samples: list[TrackedPositions]

    @property
    def errors(self) -> Array:
        """Return measured minus true positions (m), shape (images, 2); NaN while hidden."""
        return np.array([[s.rear, s.front] for s in self.samples]) - self.truth


def video(
    settings: CameraSettings,
    times: Array,
    motion: Callable[[float], tuple[float, float]] = crawling,
    setup: TrackerSetup | None = None,
    seed: int = 1,
) -> VideoSource:
    """Return images of a motion, each blurred over its exposure, and the tracker's results."""
    camera = RenderedCamera(settings, seed)
    tracker = Tracker(setup or setup_of(settings))
    detector = MarkerDetector(tracker.setup.dictionary)
    truth, samples = [], []
    for time in times:
        image = camera.moving_image(motion, float(time))
        samples.append(tracker.see(detector.detect(image), float(time)))
        truth.append(motion(float(time)))
    return VideoSource(np.array(truth), samples)


class PaperCamera:
    """Noise-free camera that computes corners independently of the tracker."""

    def __init__(self, settings: CameraSettings = SETTINGS) -> None:
        self.settings = settings

    def marker(
        self,
        number: int,
        centre: tuple[float, float, float],
        size: float = SETTINGS.marker_size,
        tilt: Array | None = None,
    ) -> Detection:
        """Return a marker that faces -y, turned about its centre by a rotation matrix."""
        half = size / 2.0
        corners = np.array([[-half, 0, half], [half, 0, half], [half, 0, -half], [-half, 0, -half]])
        turned = corners if tilt is None else corners @ tilt.T
        return Detection(number, pixels_of(self.settings, turned + np.array(centre)), 0.3)

    def references(self) -> list[Detection]:
        """Return all reference markers of the rig."""
        return [self.marker(n, place) for n, place in self.settings.reference.items()]

    def modules(self, rear: float = 0.0, front: float = LENGTH) -> list[Detection]:
        """Return both modules' markers."""
        y, z = self.settings.module_line
        return [self.marker(0, (rear, y, z)), self.marker(1, (front, y, z))]


def turned(axis: tuple[float, float, float], angle: float) -> Array:
    """Return a rotation matrix (Rodrigues)."""
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + math.sin(angle) * cross + (1.0 - math.cos(angle)) * cross @ cross
