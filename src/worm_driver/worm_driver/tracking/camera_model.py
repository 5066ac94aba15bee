# SPDX-License-Identifier: Apache-2.0
"""Intrinsic parameters of a camera, with the names of ROS's camera_info.

Distortion models and names follow sensor_msgs/CameraInfo and image_geometry: ``plumb_bob`` (Brown's radial and
tangential distortion, 4 or 5 coefficients) and ``rational_polynomial`` (8 coefficients).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from worm_driver.driver_errors import SetupError
from worm_msgs.settings_file import FOREIGN, read_settings

Array = NDArray[np.float64]

#: Number of distortion coefficients of each model; plumb_bob may omit the last one.
COEFFICIENTS = {"plumb_bob": 5, "rational_polynomial": 8}
#: Largest difference between the numbers of two calibrations that are the same.
_ROUNDING = 1e-3


@dataclass(frozen=True)
class CameraModel:
    """Calibrated camera.

    Attributes:
        size: width and height of an image, pixels.
        focal: focal length (fx, fy), pixels.
        centre: principal point (cx, cy), pixels; (0, 0) is the centre of the first pixel.
        model: distortion model, a key of COEFFICIENTS.
        distortion: distortion coefficients in the order of camera_info.
    """

    size: tuple[int, int]
    focal: tuple[float, float]
    centre: tuple[float, float]
    model: str
    distortion: tuple[float, ...]

    @property
    def matrix(self) -> Array:
        """Camera matrix K, shape (3, 3)."""
        (fx, fy), (cx, cy) = self.focal, self.centre
        return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])

    def differs_from(self, other: CameraModel) -> bool:
        """Return True if another calibration differs in image size, in model, or by more than rounding in a number.

        Focal lengths and principal points are compared by their ratio, distortion coefficients by their difference.
        """
        if (self.size, self.model) != (other.size, other.model):
            return True
        return not (
            np.allclose(other.matrix, self.matrix, rtol=_ROUNDING, atol=0.0)
            and np.allclose(other.distortion, self.distortion, rtol=0.0, atol=_ROUNDING)
        )


@dataclass(frozen=True)
class _Matrix:
    __pydantic_config__ = FOREIGN

    data: list[float]  # row by row


@dataclass(frozen=True)
class CameraInfoFile:
    """Keys of a camera_info file that the tracker reads."""

    __pydantic_config__ = FOREIGN

    image_width: int
    image_height: int
    camera_matrix: _Matrix
    distortion_model: str
    distortion_coefficients: _Matrix


def load_camera_info(path: Path) -> CameraModel:
    """Read the camera from a YAML file in the format of ROS's camera_calibration.

    Raises:
        SetupError: The file is missing, or is not a calibration that the tracker supports.
    """
    if not path.exists():
        raise SetupError(
            f"{path}: No such file. Create it with calibrate_camera, or copy the camera's camera_info file there"
        )
    file = read_settings(path, CameraInfoFile, SetupError)
    matrix, distortion = file.camera_matrix.data, file.distortion_coefficients.data
    size = (file.image_width, file.image_height)
    try:
        return make_camera_model(size, matrix, file.distortion_model, distortion)
    except SetupError as error:
        raise SetupError(f"{path}: {error}") from None


def make_camera_model(
    size: tuple[int, int], matrix: list[float], model: str, distortion: list[float]
) -> CameraModel:
    """Return the camera described by the fields of a camera_info message.

    Args:
        size: image width and height, pixels.
        matrix: camera matrix K, row by row, 9 values.
        model: distortion_model.
        distortion: distortion coefficients D.

    Raises:
        SetupError: The camera is not calibrated, or its distortion model is not supported.
    """
    if min(size) <= 0:
        raise SetupError(
            f"image size {size[0]} x {size[1]} is not valid: both must be positive integers"
        )
    if len(matrix) != 9 or not all(map(math.isfinite, [*matrix, *distortion])):
        raise SetupError(
            "camera_matrix must have nine numbers, and all numbers of the calibration must be finite"
        )
    if matrix[0] <= 0.0 or matrix[4] <= 0.0:
        raise SetupError(
            "the focal length is not positive: the camera is not calibrated. Calibrate it with calibrate_camera"
        )
    if matrix[1] != 0.0:
        raise SetupError("a camera_matrix with skew is not supported")
    if not distortion and model in ("", "plumb_bob"):
        model, distortion = "plumb_bob", [0.0] * 5
    if model == "plumb_bob" and len(distortion) == 4:
        distortion = [*distortion, 0.0]  # the same lens
    if model not in COEFFICIENTS:
        raise SetupError(
            f"distortion_model {model!r} is not supported; use one of {', '.join(COEFFICIENTS)}"
        )
    if len(distortion) != COEFFICIENTS[model]:
        raise SetupError(f"{model} has {COEFFICIENTS[model]} coefficients, not {len(distortion)}")
    focal, centre = (matrix[0], matrix[4]), (matrix[2], matrix[5])
    return CameraModel(size, focal, centre, model, tuple(distortion))


def camera_info_text(camera: CameraModel) -> str:
    """Return the content of a camera_info YAML file, as `load_camera_info` and camera_info_manager read it."""
    fx, fy, cx, cy = *camera.focal, *camera.centre
    content = {
        "image_width": camera.size[0],
        "image_height": camera.size[1],
        "camera_name": "camera",
        "camera_matrix": _matrix(3, 3, [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]),
        "distortion_model": camera.model,
        "distortion_coefficients": _matrix(1, len(camera.distortion), list(camera.distortion)),
        "rectification_matrix": _matrix(3, 3, [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]),
        "projection_matrix": _matrix(
            3, 4, [fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0]
        ),
    }
    return yaml.safe_dump(content, sort_keys=False, default_flow_style=None)


def _matrix(rows: int, columns: int, values: list[float]) -> dict[str, Any]:
    return {"rows": rows, "cols": columns, "data": [float(value) for value in values]}
