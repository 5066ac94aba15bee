# SPDX-License-Identifier: Apache-2.0
"""Position of a module marker along the pipe, and plausibility checks of its detection."""

import math
from dataclasses import dataclass

import numpy as np

from worm_driver.tracking import vision
from worm_driver.tracking.camera_model import Array, CameraModel
from worm_driver.tracking.camera_pose import CameraPose
from worm_driver.tracking.tracker_setup import ModuleLine, TrackerSetup
from worm_driver.tracking.vision import Detection

#: Largest accepted distance of a marker's centre from the modules' line, relative to the marker's side. It allows for
#: the play of a module in the pipe.
_OFF_LINE = 0.3
#: Largest accepted relative deviation of a side from marker_size_m.
_SIZE = 0.12
#: Largest accepted angle between a side of the marker and its direction in an upright print, rad.
_TURNED = 0.2
#: Largest accepted width of an edge, cells of the marker. With wider edges, neighbouring cells merge.
BLURRED = 0.8


@dataclass(frozen=True)
class Fix:
    """Position along the pipe (m) of a marker's centre or of a fin root; NaN with a reason if it was rejected."""

    position: float
    reason: str = ""


def locate(setup: TrackerSetup, camera: CameraModel, pose: CameraPose, detection: Detection) -> Fix:
    """Return the position (m) of a module's marker on the line that the modules move along.

    The image of the marker's centre is the intersection of the diagonals, also if the print is tilted. The returned
    position is that of the point of the line that is closest to the camera's ray through the marker's centre. The
    position is NaN, with a reason, if the detection is implausible.
    """
    rays = vision.directions(camera, detection.corners)
    if not np.isfinite(rays).all():
        return _rejected("outside the range of the lens calibration")
    position, offset = _nearest_on_line(setup.line, pose, _crossing(rays))
    problem = _problem(setup, pose, detection, rays, offset)
    return _rejected(problem) if problem else Fix(position)


def _rejected(reason: str) -> Fix:
    return Fix(float("nan"), reason)


def _crossing(rays: Array) -> Array:
    """Return the ray direction (x/z, y/z), shape (2,), of the intersection of a marker's diagonals."""
    corners = np.column_stack([rays, np.ones(4)])
    diagonals = np.cross(corners[0], corners[2]), np.cross(corners[1], corners[3])
    point = np.cross(*diagonals)
    crossing: Array = point[:2] / point[2]
    return crossing


def _nearest_on_line(line: ModuleLine, pose: CameraPose, ray: Array) -> tuple[float, float]:
    """Return the x (m) of the point of the line closest to a ray, and its distance (m) from the ray."""
    along = pose.rotation[:, 0]
    start = pose.rotation @ np.array([0.0, line.y, line.z]) + pose.shift
    # If (start + x * along) is on the ray, its projection equals ray: two equations, linear in x. Their residual is the
    # distance from the ray in m, perpendicular to the optical axis.
    slope = along[:2] - ray * along[2]
    offset = start[:2] - ray * start[2]
    x = -float(slope @ offset / (slope @ slope))
    return x, float(np.hypot(*(slope * x + offset)))


def _problem(
    setup: TrackerSetup, pose: CameraPose, detection: Detection, rays: Array, offset: float
) -> str:
    """Return why a detection is implausible; an empty string if it is plausible."""
    if not math.isfinite(detection.edge_width):
        return "without clear edges (glare, or partly covered)"
    if detection.edge_width > BLURRED:
        return f"blurred over {detection.edge_width:.1f} cells"
    if offset > _OFF_LINE * setup.marker_size:
        return f"at an implausible position, {offset * 1e3:.1f} mm from the modules' line"
    sides = np.diff(_on_plane(setup.line.y, pose, rays), axis=0, append=0.0)
    sides[3] = -sides[:3].sum(axis=0)
    lengths = np.hypot(*sides.T) / setup.marker_size
    if np.abs(lengths - 1.0).max() > _SIZE:
        return f"of the wrong size, {lengths.mean():.2f} of marker_size_m"
    upright = np.array([[-pose.facing, 0.0], [0.0, -1.0], [pose.facing, 0.0], [0.0, 1.0]])
    turned = np.arccos(np.clip((sides * upright).sum(axis=1) / np.hypot(*sides.T), -1.0, 1.0))
    if turned.max() > _TURNED:
        return f"rotated by {np.degrees(turned.max()):.0f} degrees"
    return ""


def _on_plane(y: float, pose: CameraPose, rays: Array) -> Array:
    """Return x and z (m), shape (n, 2), of the points where rays meet the plane of the modules' prints."""
    ahead = np.column_stack([rays, np.ones(len(rays))]) @ pose.rotation
    eye = pose.position
    depth = (y - eye[1]) / ahead[:, 1]
    points: Array = eye[[0, 2]] + depth[:, None] * ahead[:, [0, 2]]
    return points
