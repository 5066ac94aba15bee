# SPDX-License-Identifier: Apache-2.0
"""Camera pose from the reference markers on the pipe, and detection of camera motion."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from worm_driver.driver_errors import PoseError
from worm_driver.tracking import vision
from worm_driver.tracking.camera_model import Array, CameraModel
from worm_driver.tracking.tracker_setup import FEWEST_REFERENCES, TrackerSetup

#: Limits of the rms distance of the reference markers' corners from their positions in the setup file (m). Above
#: _MISPLACED, the pose is rejected; above DOUBTFUL, the tracker warns. The limits are small because the fitted pose
#: absorbs most of a wrong position: an error of 10 mm along the pipe leaves a residual of 0.9 mm, and an error of 2 mm
#: leaves a residual of 0.2 mm.
_MISPLACED, DOUBTFUL = 0.0007, 0.00015
#: The pose is ambiguous if a second pose has an error below _ALMOST times the best error, and an orientation that
#: differs by more than _OTHER_DIRECTION (rad).
_ALMOST, _OTHER_DIRECTION = 1.5, 0.03
#: Displacement of a marker in the image above which the marker counts as moved (pixels). It is twenty times the noise
#: of a marker's centre, and a quarter of a millimetre at 2 pixels per mm.
_MOVED = 0.5
#: Number of images averaged for each marker of a fixed camera, a power of 2. More images would not help, because the
#: errors of the markers' positions dominate.
_AVERAGED = 128

#: Corners (right, up) of a print (a printed marker) with side 1, in the order of `Detection.corners`.
_UNIT_CORNERS = np.array([[-0.5, 0.5], [0.5, 0.5], [0.5, -0.5], [-0.5, -0.5]])

Corners = Mapping[int, Array]


@dataclass(frozen=True)
class CameraPose:
    """Camera pose: a point of the pipe's frame is at rotation @ point + shift (m) in the camera's optical frame.

    Attributes:
        rotation: rotation matrix, shape (3, 3).
        shift: translation, shape (3,), m.
        facing: direction in which the front of the printed markers points: -1 for -y, 1 for +y.
        error: rms reprojection error of the corners, pixels.
        error_m: the same error at the mean distance of the markers from the camera, m.
    """

    rotation: Array
    shift: Array
    facing: int
    error: float
    error_m: float

    @property
    def position(self) -> Array:
        """Position of the camera in the pipe's frame, shape (3,), m."""
        place: Array = -self.rotation.T @ self.shift
        return place


def print_corners(centre: tuple[float, float, float], size: float, facing: int) -> Array:
    """Return the corners (m) of an upright print in the pipe's frame, shape (4, 3), ordered as `Detection.corners`.

    Args:
        centre: centre of the print, m.
        size: side of the black square, m.
        facing: direction of the print, see `CameraPose`.
    """
    right, up = size * _UNIT_CORNERS.T
    return np.array(centre) + np.column_stack([-facing * right, np.zeros(4), up])


def find_pose(setup: TrackerSetup, camera: CameraModel, corners_of: Corners) -> CameraPose:
    """Return the camera's pose.

    Args:
        setup: the rig.
        camera: calibrated camera.
        corners_of: corners (pixels, shape (4, 2)) of each visible reference marker, by marker number.
    """
    if len(corners_of) < FEWEST_REFERENCES:
        have = ", ".join(map(str, corners_of)) or "none"
        raise PoseError(
            f"reference markers in view: {have}; at least {FEWEST_REFERENCES} are needed"
        )
    pixels = np.concatenate(list(corners_of.values()))
    rays = vision.directions(camera, pixels)
    if not np.isfinite(rays).all():
        raise PoseError("a reference marker lies outside the range of the lens calibration")
    candidates = []
    for facing in (-1, 1):
        prints = [print_corners(setup.reference[n], setup.marker_size, facing) for n in corners_of]
        places = np.concatenate(prints)
        for rotation, shift in vision.poses(places, rays):
            wrong = vision.project(camera, places, rotation, shift) - pixels
            depth = float((places @ rotation.T + shift)[:, 2].mean())
            # The markers must not be behind the camera.
            error = float(np.sqrt((wrong**2).sum(axis=1).mean())) if depth > 0.0 else math.inf
            error_m = error * depth / camera.focal[0] if depth > 0.0 else math.inf
            candidates.append(CameraPose(rotation, shift, facing, error, error_m))
    candidates.sort(key=lambda candidate: candidate.error)
    best = candidates[0]
    if not best.error_m <= _MISPLACED:
        raise PoseError(
            f"the reference markers are {best.error_m * 1e3:.1f} mm (rms) from their positions in the setup file: "
            "check reference, marker_size_m and camera_info, and that the prints are upright"
        )
    for other in candidates[1:]:
        if other.error < _ALMOST * best.error and _angle(best, other) > _OTHER_DIRECTION:
            raise PoseError(
                "two camera positions fit the reference markers equally well: place the markers further apart, or "
                "move closer"
            )
    return best


def _angle(one: CameraPose, other: CameraPose) -> float:
    """Return the angle between two camera orientations, rad."""
    cosine = (np.trace(one.rotation.T @ other.rotation) - 1.0) / 2.0
    return math.acos(min(max(float(cosine), -1.0), 1.0))


@dataclass(frozen=True)
class PoseEstimate:
    """Camera pose estimated from one image.

    Attributes:
        pose: the pose; None if it cannot be determined or is not reliable.
        problem: why `pose` is None; empty otherwise.
        event: message to log once, for example that the camera was moved; usually empty.
    """

    pose: CameraPose | None
    problem: str = ""
    event: str = ""


class FixedCamera:
    """Pose estimator for a stationary camera. It averages the reference markers' positions in the image.

    A marker of a new image that is away from its average has moved, or the camera has.

    The pose is estimated again whenever a marker has been averaged over 1, 2, 4, 8, ..., _AVERAGED images, so a new
    marker counts at once. If the estimate is rejected, each further image repeats it; an older pose is not used.
    """

    def __init__(self, setup: TrackerSetup, camera: CameraModel):
        self._setup = setup
        self._camera = camera
        self._seen: dict[int, list[Array]] = {}  # corners to be averaged, by marker number
        self._pose: CameraPose | None = None
        self._stray: set[int] = set()

    def update(self, corners_of: Corners) -> PoseEstimate:
        """Add the reference markers of the next image, and return the estimate."""
        trusted = {
            number: corners for number, corners in corners_of.items() if number not in self._stray
        }
        if not trusted:
            return PoseEstimate(None, "no reference marker in view: the camera cannot be checked")
        moved = {
            n: distance for n in trusted if (distance := self._distance(n, trusted[n])) > _MOVED
        }
        if moved:
            return self._explain(moved, trusted)
        self._average(trusted)
        try:
            if self._pose is None:
                means = {n: np.mean(seen, axis=0) for n, seen in self._seen.items()}
                self._pose = find_pose(self._setup, self._camera, means)
        except PoseError as error:
            return PoseEstimate(None, str(error))
        return PoseEstimate(self._pose)

    def _distance(self, number: int, corners: Array) -> float:
        """Return the distance of a marker's centre from its mean position, pixels; 0 for a new marker."""
        if number not in self._seen:
            return 0.0
        mean = np.mean(self._seen[number], axis=0)
        return float(np.hypot(*(corners - mean).mean(axis=0)))

    def _explain(self, moved: Mapping[int, float], corners_of: Corners) -> PoseEstimate:
        """Return the estimate after markers have moved, and restart the averages.

        ``moved`` contains the displacement of each moved marker by its number, pixels.
        """
        names = ", ".join(f"{n} by {distance:.1f} px" for n, distance in moved.items())
        problem = "the camera or reference markers moved"
        event = (
            f"reference markers moved in the image ({names}): the camera, or these markers, moved"
        )
        if len(moved) == 1 and len(corners_of) - 1 >= FEWEST_REFERENCES:
            self._stray |= moved.keys()
            problem = f"reference marker {names.split()[0]} moved"
            event = f"reference marker {names} moved relative to the other markers. It is ignored from now on"
        self._seen, self._pose = {}, None
        self._average({n: corners for n, corners in corners_of.items() if n not in self._stray})
        return PoseEstimate(None, problem, event)

    def _average(self, corners_of: Corners) -> None:
        """Add corners to the averages. Discard the pose if it is to be estimated again."""
        for number, corners in corners_of.items():
            seen = self._seen.setdefault(number, [])
            if len(seen) < _AVERAGED:
                seen.append(corners)
                if len(seen).bit_count() == 1:  # a power of 2
                    self._pose = None
