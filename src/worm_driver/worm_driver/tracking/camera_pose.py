# SPDX-License-Identifier: Apache-2.0
"""Where the camera is, from the markers that are fixed to the pipe, and whether it was moved."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from worm_driver.tracking import vision
from worm_driver.tracking.camera_model import Array, CameraModel
from worm_driver.tracking.tracker_setup import FEWEST_REFERENCES, TrackerSetup
from worm_driver.tracking.tracking_errors import PoseError

#: m, by which the corners of the reference markers may lie beside where the setup file has them (rms); most of a
#: wrong place is hidden by a wrong pose: a marker that is 10 mm off along the pipe leaves 0.9 mm, one of 2 mm 0.2 mm
_MISPLACED, DOUBTFUL = 0.0007, 0.00015
#: A second pose that fits the same corners almost as well, and looks from a direction that differs by more (rad)
_ALMOST, _OTHER_DIRECTION = 1.5, 0.03
#: pixels; twenty times the noise of a marker's centre, and still below a quarter of a millimetre at 2 pixels a mm
_MOVED = 0.5
#: images that are averaged for a fixed camera; more bring nothing that the prints' places would not spoil
_AVERAGED = 128

_UNIT_CORNERS = np.array([[-0.5, 0.5], [0.5, 0.5], [0.5, -0.5], [-0.5, -0.5]])  # right, up

Corners = Mapping[int, Array]


@dataclass(frozen=True)
class CameraPose:
    """A camera that sees a point of the pipe's frame at rotation @ point + shift (m) in its optical frame.

    Attributes:
        rotation: shape (3, 3).
        shift: shape (3,), m.
        facing: -1 if the prints face -y and the camera stands there, 1 if +y.
        error: rms distance of the corners from where the setup has them, pixels.
        error_m: the same in m at the markers' distance.
    """

    rotation: Array
    shift: Array
    facing: int
    error: float
    error_m: float

    @property
    def position(self) -> Array:
        """Of the camera in the pipe's frame, shape (3,), m."""
        place: Array = -self.rotation.T @ self.shift
        return place


def print_corners(centre: tuple[float, float, float], size: float, facing: int) -> Array:
    """Corners (m), shape (4, 3), of an upright print that faces -y or +y, in the order of a Detection."""
    corners = np.tile(np.array(centre), (4, 1))
    corners[:, 0] -= facing * size * _UNIT_CORNERS[:, 0]
    corners[:, 2] += size * _UNIT_CORNERS[:, 1]
    return corners


def find_pose(setup: TrackerSetup, camera: CameraModel, corners_of: Corners) -> CameraPose:
    """The camera's pose from the corners (pixels, shape (4, 2)) of reference markers by their numbers.

    Raises PoseError: too few markers are seen, two poses fit alike, or none fits.
    """
    if len(corners_of) < FEWEST_REFERENCES:
        have = ", ".join(map(str, corners_of)) or "none"
        raise PoseError(f"reference markers in view: {have}; {FEWEST_REFERENCES} are needed")
    pixels = np.concatenate(list(corners_of.values()))
    rays = vision.directions(camera, pixels)
    if not np.isfinite(rays).all():
        raise PoseError("a reference marker is where the lens calibration does not reach")
    candidates = sorted(
        (
            _judged(setup, camera, corners_of, facing, pose)
            for facing in (-1, 1)
            for pose in vision.poses(_places(setup, corners_of, facing), rays)
        ),
        key=lambda candidate: candidate.error,
    )
    best = candidates[0]
    if not best.error_m <= _MISPLACED:
        raise PoseError(
            f"the reference markers lie {best.error_m * 1e3:.1f} mm beside the places of the setup file: "
            "check reference, marker_size_m and camera_info, and that the prints stand upright"
        )
    for other in candidates[1:]:
        if other.error < _ALMOST * best.error and _angle(best, other) > _OTHER_DIRECTION:
            raise PoseError(
                "two places of the camera fit the reference markers alike: spread them wider, or come closer"
            )
    return best


def _places(setup: TrackerSetup, corners_of: Corners, facing: int) -> Array:
    corners = [print_corners(setup.reference[n], setup.marker_size, facing) for n in corners_of]
    return np.concatenate(corners)


def _judged(
    setup: TrackerSetup,
    camera: CameraModel,
    corners_of: Corners,
    facing: int,
    pose: tuple[Array, Array],
) -> CameraPose:
    rotation, shift = pose
    places = _places(setup, corners_of, facing)
    depth = float((places @ rotation.T + shift)[:, 2].mean())
    if not depth > 0.0:  # behind the camera, or no pose at all
        return CameraPose(rotation, shift, facing, math.inf, math.inf)
    wrong = vision.project(camera, places, rotation, shift) - np.concatenate(
        list(corners_of.values())
    )
    error = float(np.sqrt((wrong**2).sum(axis=1).mean()))
    return CameraPose(rotation, shift, facing, error, error * depth / camera.focal[0])


def _angle(one: CameraPose, other: CameraPose) -> float:
    """Between the directions in which two cameras look, rad."""
    cosine = (np.trace(one.rotation.T @ other.rotation) - 1.0) / 2.0
    return math.acos(min(max(float(cosine), -1.0), 1.0))


@dataclass(frozen=True)
class Watch:
    """What an image says of the camera.

    Attributes:
        pose: None where it cannot be told, or not be trusted.
        problem: why not; empty where it can.
        news: what is to be told once, such as that the camera was moved; most often empty.
    """

    pose: CameraPose | None
    problem: str = ""
    news: str = ""


class FixedCamera:
    """The pose of a camera that stands still: averaged over images, and checked against each new one."""

    def __init__(self, setup: TrackerSetup, camera: CameraModel):
        self._setup = setup
        self._camera = camera
        self._sums: dict[int, Array] = {}
        self._counts: dict[int, int] = {}
        self._images = 0
        self._pose: CameraPose | None = None
        self._stray: set[int] = set()

    def look(self, corners_of: Corners) -> Watch:
        """Takes the reference markers of the next image."""
        trusted = {
            number: corners for number, corners in corners_of.items() if number not in self._stray
        }
        if not trusted:
            return Watch(None, "no reference marker in view: the camera cannot be checked")
        moved = {
            n: distance for n in trusted if (distance := self._distance(n, trusted[n])) > _MOVED
        }
        if moved:
            return self._explain(moved, trusted)
        self._average(trusted)
        try:
            self._improve()
        except PoseError as error:
            return Watch(None, str(error))
        return Watch(self._pose)

    def _distance(self, number: int, corners: Array) -> float:
        """Pixels by which a marker is off its mean place."""
        if number not in self._sums:
            return 0.0
        mean = self._sums[number] / self._counts[number]
        return float(np.hypot(*(corners - mean).mean(axis=0)))

    def _explain(self, moved: Mapping[int, float], corners_of: Corners) -> Watch:
        names = ", ".join(f"{n} by {distance:.1f} px" for n, distance in moved.items())
        still = len(corners_of) - len(moved)
        if len(moved) == 1 and still >= FEWEST_REFERENCES:
            (number,) = moved
            self._stray.add(number)
            self._forget()
            self._average({n: corners for n, corners in corners_of.items() if n not in self._stray})
            news = f"reference marker {names} against the others: it has come off, or was moved; it counts no more"
            return Watch(None, f"reference marker {number} moved", news)
        self._forget()
        self._average(corners_of)
        cause = "the camera" if not still else "the camera, or these markers,"
        return Watch(
            None, "camera moved", f"reference markers moved in the image ({names}): {cause} moved"
        )

    def _forget(self) -> None:
        self._sums, self._counts, self._images, self._pose = {}, {}, 0, None

    def _average(self, corners_of: Corners) -> None:
        self._images += 1
        for number, corners in corners_of.items():
            if self._counts.get(number, 0) < _AVERAGED:
                self._sums[number] = self._sums.get(number, 0.0) + corners
                self._counts[number] = self._counts.get(number, 0) + 1

    def _improve(self) -> None:
        """Finds the pose anew at the first image and whenever their number has doubled."""
        due = self._images <= _AVERAGED and self._images & (self._images - 1) == 0
        if due or self._pose is None:
            means = {n: total / self._counts[n] for n, total in self._sums.items()}
            self._pose = find_pose(self._setup, self._camera, means)


class MovingCamera:
    """The pose of a camera that may move, from each image alone."""

    def __init__(self, setup: TrackerSetup, camera: CameraModel):
        self._setup = setup
        self._camera = camera

    def look(self, corners_of: Corners) -> Watch:
        """Takes the reference markers of the next image."""
        try:
            return Watch(find_pose(self._setup, self._camera, corners_of))
        except PoseError as error:
            return Watch(None, str(error))
