# SPDX-License-Identifier: Apache-2.0
"""Where on the modules' line a marker is, and whether what was seen can be that marker at all."""

import math
from dataclasses import dataclass

import numpy as np

from worm_driver.tracking import vision
from worm_driver.tracking.camera_model import Array, CameraModel
from worm_driver.tracking.camera_pose import CameraPose
from worm_driver.tracking.tracker_setup import TrackerSetup
from worm_driver.tracking.vision import Detection

#: Of the marker's side, by which its centre may be beside the line: a module has some play in the pipe
_OFF_LINE = 0.3
#: Relative, by which its sides may differ from its size
_SIZE = 0.12
#: rad, by which a side may be turned against the pipe's axis
_TURNED = 0.2
#: Cells over which its edges may rise; beyond, one cell runs into the next
BLURRED = 0.8


@dataclass(frozen=True)
class Fix:
    """A marker's centre along the pipe, m, NaN with the reason in words where it is not believed."""

    position: float
    reason: str = ""


def locate(setup: TrackerSetup, camera: CameraModel, pose: CameraPose, detection: Detection) -> Fix:
    """The x of the centre of a module's marker (m), on the line that the modules move on.

    The centre is where the diagonals cross, which no tilt of the print moves. x is the point of the line whose ray
    passes nearest to it.
    """
    rays = vision.directions(camera, detection.corners)
    if not np.isfinite(rays).all():
        return _refused("where the lens calibration does not reach")
    position, beside = _nearest_on_line(setup.line, pose, _crossing(rays))
    problem = _problem(setup, pose, detection, rays, beside)
    return _refused(problem) if problem else Fix(position)


def _refused(reason: str) -> Fix:
    return Fix(float("nan"), reason)


def _crossing(rays: Array) -> Array:
    """Where the diagonals of a quadrilateral cross, shape (2,)."""
    corners = np.column_stack([rays, np.ones(4)])
    diagonals = np.cross(corners[0], corners[2]), np.cross(corners[1], corners[3])
    point = np.cross(*diagonals)
    crossing: Array = point[:2] / point[2]
    return crossing


def _nearest_on_line(
    line: tuple[float, float], pose: CameraPose, ray: Array
) -> tuple[float, float]:
    """The x (m) of the point of the line nearest to a ray in the image, and by how much the ray misses it (m)."""
    along = pose.rotation[:, 0]
    start = pose.rotation @ np.array([0.0, *line]) + pose.shift
    # (start + x * along) seen at ray: two equations linear in x, both in m at the point's depth.
    slope = along[:2] - ray * along[2]
    offset = start[:2] - ray * start[2]
    x = -float(slope @ offset / (slope @ slope))
    return x, float(np.hypot(*(slope * x + offset)))


def _problem(
    setup: TrackerSetup, pose: CameraPose, detection: Detection, rays: Array, beside: float
) -> str:
    """Why a detection is not believed; empty if it is."""
    if not math.isfinite(detection.edge_width):
        return "without clear edges (glare, or partly covered)"
    if detection.edge_width > BLURRED:
        return f"blurred over {detection.edge_width:.1f} cells"
    if beside > _OFF_LINE * setup.marker_size:
        return f"at a wild place, {beside * 1e3:.1f} mm beside the modules' line"
    sides = np.diff(_on_plane(setup.line[0], pose, rays), axis=0, append=0.0)
    sides[3] = -sides[:3].sum(axis=0)
    lengths = np.hypot(*sides.T) / setup.marker_size
    if np.abs(lengths - 1.0).max() > _SIZE:
        return f"of a wrong size, {lengths.mean():.2f} of marker_size_m"
    upright = np.array([[-pose.facing, 0.0], [0.0, -1.0], [pose.facing, 0.0], [0.0, 1.0]])
    turned = np.arccos(np.clip((sides * upright).sum(axis=1) / np.hypot(*sides.T), -1.0, 1.0))
    if turned.max() > _TURNED:
        return f"turned by {np.degrees(turned.max()):.0f} degrees"
    return ""


def _on_plane(y: float, pose: CameraPose, rays: Array) -> Array:
    """The x and z (m), shape (n, 2), of what is seen at rays in the plane of the modules' prints."""
    ahead = np.column_stack([rays, np.ones(len(rays))]) @ pose.rotation
    eye = pose.position
    depth = (y - eye[1]) / ahead[:, 1]
    points: Array = eye[[0, 2]] + depth[:, None] * ahead[:, [0, 2]]
    return points
