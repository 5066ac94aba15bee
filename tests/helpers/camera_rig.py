# SPDX-License-Identifier: Apache-2.0
"""The setup of a rig before a rendered camera, and the corners of its markers by an independent computation."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rendered_images import CameraSettings, axes_of

from worm_driver.tracking.camera_model import CameraModel
from worm_driver.tracking.tracker_setup import ModuleLine, ModuleMarker, TrackerSetup
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
    setup = TrackerSetup(
        dictionary="DICT_4X4_50",
        marker_size=settings.marker_size,
        rear=ModuleMarker(0, 0.0),
        front=ModuleMarker(1, 0.0),
        line=ModuleLine(*settings.module_line),
        reference=settings.reference,
        camera_info=str(SETUP_FILE.with_name("camera_info.yaml")),
    )
    return replace(setup, **changes)  # type: ignore[arg-type]


class PaperCamera:
    """Noise-free camera that computes corners independently of the tracker."""

    def __init__(self, settings: CameraSettings = SETTINGS) -> None:
        self.settings = settings

    def pixels(self, points: Array) -> Array:
        """Return the pixels, shape (n, 2), of points in the pipe's frame, shape (n, 3), m."""
        s = self.settings
        seen = (points - np.array(s.position)) @ axes_of(s).T
        x, y = (seen[:, :2] / seen[:, 2:]).T
        k1, k2, p1, p2, k3 = s.distortion
        r2 = x * x + y * y
        radial = 1.0 + k1 * r2 + k2 * r2**2 + k3 * r2**3
        bent = np.stack(
            [
                x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
                y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
            ],
            axis=1,
        )
        return bent * s.focal + np.array(s.centre)

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
        return Detection(number, self.pixels(turned + np.array(centre)), 0.3)

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
