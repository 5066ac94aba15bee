# SPDX-License-Identifier: Apache-2.0
"""The setup of a rig before a rendered camera, and the corners of its markers by an independent computation."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rendered_images import CameraSettings, pixels_of

from worm_driver.tracking.camera_model import CameraModel
from worm_driver.tracking.tracker_setup import ModuleLine, TrackerSetup, load_setup
from worm_driver.tracking.vision import Detection

Array = NDArray[np.float64]
SETTINGS = CameraSettings()
SETUP_FILE = Path(__file__).with_name("tracker.yaml")  # the same rig, as the tracker reads it
LENGTH = 0.2952


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
