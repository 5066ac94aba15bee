# SPDX-License-Identifier: Apache-2.0
"""Calibrations: their file, and the geometry of the lens compared with an independent computation."""

import math
from dataclasses import replace

import numpy as np
import pytest
import yaml
from camera_rig import SETTINGS, model_of
from rendered_images import pixels_of

from worm_driver.driver_errors import SetupError
from worm_driver.tracking import vision
from worm_driver.tracking.camera_model import CameraModel, camera_info_text, load_camera_info

BROWN = model_of(SETTINGS)
RATIONAL = replace(
    BROWN, model="rational_polynomial", distortion=(0.3, 0.1, 1e-3, -1e-3, 0.02, 0.25, 0.08, 0.01)
)
STRAIGHT = replace(SETTINGS, position=(0.0, -1.0, 0.0), yaw=0.0, pitch_angle=0.0, roll=0.0)


@pytest.mark.parametrize("camera", [BROWN, RATIONAL], ids=lambda c: c.model)
def test_the_file_is_read_as_it_was_written(camera: CameraModel, tmp_path):
    path = tmp_path / "camera.yaml"
    path.write_text(camera_info_text(camera))
    assert load_camera_info(path) == camera
    content = yaml.safe_load(path.read_text())
    assert content["camera_matrix"]["rows"] == content["camera_matrix"]["cols"] == 3
    assert len(content["projection_matrix"]["data"]) == 12


def test_a_missing_fifth_coefficient_is_zero(tmp_path):
    content = yaml.safe_load(camera_info_text(BROWN))
    content["distortion_coefficients"]["data"].pop()
    path = tmp_path / "camera.yaml"
    path.write_text(yaml.safe_dump(content))
    assert load_camera_info(path).distortion == (*BROWN.distortion[:4], 0.0)


@pytest.mark.parametrize("camera", [BROWN, RATIONAL], ids=lambda c: c.model)
def test_directions_are_the_inverse_of_projecting(camera: CameraModel):
    columns, rows = np.meshgrid(np.linspace(0, 1279, 9), np.linspace(0, 719, 7))
    pixels = np.column_stack([columns.ravel(), rows.ravel()])
    rays = vision.directions(camera, pixels)
    points = 0.7 * np.column_stack([rays, np.ones(len(rays))])
    again = vision.project(camera, points, np.eye(3), np.zeros(3))
    assert again == pytest.approx(pixels, abs=1e-4)


def test_projection_agrees_with_an_independent_camera():
    points = np.random.default_rng(1).uniform(-0.4, 0.4, (50, 3))
    optical = np.column_stack([points[:, 0], -points[:, 2], points[:, 1] + 1.0])
    pixels = vision.project(BROWN, optical, np.eye(3), np.zeros(3))
    assert pixels == pytest.approx(pixels_of(STRAIGHT, points), abs=1e-6)


def test_where_the_lens_model_folds_over_there_is_no_direction():
    strong = replace(BROWN, distortion=(-0.9, 0.0, 0.0, 0.0, 0.0))
    rays = vision.directions(strong, np.array([[652.0, 352.0], [1279.0, 0.0]]))
    assert np.isfinite(rays[0]).all()
    assert np.isnan(rays[1]).all()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"image_width": 0}, "image_width.*0"),
        ({"camera_matrix": {"data": [0.0] * 9}}, "the camera is not calibrated"),
        ({"camera_matrix": {"data": [1.0] * 8}}, "camera_matrix.* nine "),
        ({"camera_matrix": {"data": [900.0, 2.0, 640.0, 0, 900.0, 360.0, 0, 0, 1.0]}}, "skew"),
        ({"camera_matrix": [1.0]}, r"camera_matrix.* mapping"),
        ({"distortion_model": "thin_prism"}, "thin_prism.*plumb_bob, rational_polynomial"),
        ({"distortion_coefficients": {"data": [0.1, 0.2]}}, "5 coefficients, not 2"),
        ({"distortion_coefficients": {"data": [0.0, 0.0, 0.0, math.nan]}}, "nan"),
    ],
)
def test_invalid_calibrations_are_rejected(change, message, tmp_path):
    content = yaml.safe_load(camera_info_text(BROWN))
    path = tmp_path / "camera.yaml"
    path.write_text(yaml.safe_dump({**content, **change}))
    with pytest.raises(SetupError, match=message):
        load_camera_info(path)


def test_keys_that_the_tracker_does_not_read_may_have_any_value(tmp_path):
    content = yaml.safe_load(camera_info_text(BROWN))
    content["camera_matrix"]["unit"] = "px"
    path = tmp_path / "camera.yaml"
    path.write_text(yaml.safe_dump({**content, "projection_matrix": math.nan, "made": [None]}))
    assert load_camera_info(path) == BROWN
