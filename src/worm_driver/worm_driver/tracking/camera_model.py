# SPDX-License-Identifier: Apache-2.0
"""Intrinsic parameters of a camera, with the names of ROS's camera_info.

Distortion models and names follow sensor_msgs/CameraInfo and image_geometry: ``plumb_bob`` (Brown's radial and
tangential distortion, 4 or 5 coefficients) and ``rational_polynomial`` (8 coefficients).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import yaml
from numpy.typing import NDArray

from worm_driver.driver_errors import SetupError
from worm_msgs.settings_file import FOREIGN, key, read_settings

Array = NDArray[np.float64]

#: Number of distortion coefficients of each model; plumb_bob may omit the last one, or all.
COEFFICIENTS = {"plumb_bob": 5, "rational_polynomial": 8}


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


@dataclass(frozen=True)
class _Matrix:
    __pydantic_config__ = FOREIGN

    data: list[float]  # row by row


@dataclass(frozen=True)
class CameraInfoFile:
    """Keys of a camera_info file that the tracker reads."""

    __pydantic_config__ = FOREIGN

    image_width: Annotated[int, key(gt=0)]
    image_height: Annotated[int, key(gt=0)]
    camera_matrix: _Matrix
    distortion_model: str
    distortion_coefficients: _Matrix


def load_camera_info(path: Path) -> CameraModel:
    """Read the camera from a YAML file in the format of ROS's camera_calibration."""
    if not path.exists():
        raise SetupError(
            f"{path}: No such file. Create it with calibrate_camera, or copy the camera's camera_info file there"
        )
    file = read_settings(path, CameraInfoFile, SetupError)
    matrix, model = file.camera_matrix.data, file.distortion_model or "plumb_bob"
    distortion = file.distortion_coefficients.data
    if len(matrix) != 9 or matrix[1] != 0.0:
        raise SetupError(f"{path}: camera_matrix must have nine numbers, and no skew")
    if matrix[0] <= 0.0 or matrix[4] <= 0.0:
        raise SetupError(
            f"{path}: the focal length is not positive: the camera is not calibrated. Calibrate it with "
            "calibrate_camera"
        )
    if model not in COEFFICIENTS:
        raise SetupError(
            f"{path}: distortion_model {model!r} is not supported; use one of {', '.join(COEFFICIENTS)}"
        )
    if model == "plumb_bob" and len(distortion) in (0, 4):
        distortion = [*distortion, *[0.0] * 5][:5]  # the same lens
    if len(distortion) != COEFFICIENTS[model]:
        raise SetupError(
            f"{path}: {model} has {COEFFICIENTS[model]} coefficients, not {len(distortion)}"
        )
    size, focal = (file.image_width, file.image_height), (matrix[0], matrix[4])
    return CameraModel(size, focal, (matrix[2], matrix[5]), model, tuple(distortion))


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
