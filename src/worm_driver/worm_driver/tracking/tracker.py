# SPDX-License-Identifier: Apache-2.0
"""Tracker that converts detected markers into x1 and x2, or NaN with a reason, and its diagnostic report."""

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from worm_driver.control.diagnostics import DiagnosticReport, Level
from worm_driver.tracking import vision
from worm_driver.tracking.camera_model import Array, CameraModel, load_camera_info
from worm_driver.tracking.camera_pose import DOUBTFUL, CameraPose, FixedCamera
from worm_driver.tracking.tracker_setup import ModuleLine, ModuleMarker, TrackerSetup
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


class HiddenError(Exception):
    """A module has no position. The message is the reason."""


def locate(
    setup: TrackerSetup, camera: CameraModel, pose: CameraPose, detection: Detection
) -> float:
    """Return the position (m) of a module's marker on the line that the modules move along.

    The image of the marker's centre is the intersection of the diagonals, also if the print is tilted. The returned
    position is that of the point of the line that is closest to the camera's ray through the marker's centre.
    """
    rays = vision.directions(camera, detection.corners)
    if not np.isfinite(rays).all():
        raise HiddenError("outside the range of the lens calibration")
    position, offset = _nearest_on_line(setup.line, pose, _crossing(rays))
    _check_plausible(setup, pose, detection, rays, offset)
    return position


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


def _check_plausible(
    setup: TrackerSetup, pose: CameraPose, detection: Detection, rays: Array, offset: float
) -> None:
    """Raise HiddenError if a detection is implausible."""
    if not math.isfinite(detection.edge_width):
        raise HiddenError("without clear edges (glare, or partly covered)")
    if detection.edge_width > BLURRED:
        raise HiddenError(f"blurred over {detection.edge_width:.1f} cells")
    if offset > _OFF_LINE * setup.marker_size:
        raise HiddenError(
            f"at an implausible position, {offset * 1e3:.1f} mm from the modules' line"
        )
    corners = _on_plane(setup.line.y, pose, rays)
    sides = np.roll(corners, -1, axis=0) - corners
    lengths = np.hypot(*sides.T)
    ratios = lengths / setup.marker_size
    if np.abs(ratios - 1.0).max() > _SIZE:
        raise HiddenError(f"of the wrong size, {ratios.mean():.2f} of marker_size_m")
    upright = np.array([[-pose.facing, 0.0], [0.0, -1.0], [pose.facing, 0.0], [0.0, 1.0]])
    turned = np.arccos(np.clip((sides * upright).sum(axis=1) / lengths, -1.0, 1.0))
    if turned.max() > _TURNED:
        raise HiddenError(f"rotated by {np.degrees(turned.max()):.0f} degrees")


def _on_plane(y: float, pose: CameraPose, rays: Array) -> Array:
    """Return x and z (m), shape (n, 2), of the points where rays meet the plane of the modules' prints."""
    ahead = np.column_stack([rays, np.ones(len(rays))]) @ pose.rotation
    eye = pose.position
    depth = (y - eye[1]) / ahead[:, 1]
    points: Array = eye[[0, 2]] + depth[:, None] * ahead[:, [0, 2]]
    return points


#: Displacement between two images that is always accepted (m), because of noise and the play of a module in the pipe.
_PLAY = 0.003
#: Largest plausible speed of a module, m/s.
_MAX_SPEED = 0.5


@dataclass(frozen=True)
class TrackedPositions:
    """Module positions measured in one image.

    Attributes:
        time: time of the exposure, s.
        rear, front: positions x1 and x2 of the fin roots along +x, relative to the first reference marker, m; NaN if
            hidden or rejected.
        reason: why a position is NaN; empty if both positions are known.
        event: message to log once, for example that the camera was moved; usually empty.
        pose: pose of the camera; None if unknown.
    """

    time: float
    rear: float
    front: float
    reason: str = ""
    event: str = ""
    pose: CameraPose | None = None

    @property
    def length(self) -> float:
        """Distance between the fin roots (m); NaN if a position is NaN."""
        return self.front - self.rear


class Tracker:
    """Tracker that measures the positions of both modules in successive images.

    Args:
        setup: setup of the tracker.
    """

    def __init__(self, setup: TrackerSetup):
        self.setup = setup
        self.camera = load_camera_info(Path(setup.camera_info))
        self._pose_estimator = FixedCamera(setup, self.camera)
        self._misfit_reported = False
        self._last: dict[str, tuple[float, float]] = {}

    def see(self, detections: Sequence[Detection], stamp: float) -> TrackedPositions:
        """Return the positions of the modules from the markers of an image with a stamp (s)."""
        time = stamp - self.setup.delay
        counts = Counter(detection.number for detection in detections)
        once = {d.number: d for d in detections if counts[d.number] == 1}
        sharp = {n for n, detection in once.items() if detection.edge_width <= BLURRED}
        references = {n: once[n].corners for n in self.setup.reference if n in sharp}
        estimate = self._pose_estimator.update(references)
        if estimate.pose is None:
            return TrackedPositions(time, math.nan, math.nan, estimate.problem, estimate.event)
        event = estimate.event or self._misfit_event(estimate.pose)
        positions, reasons = {"rear": math.nan, "front": math.nan}, []
        for name, module in (("rear", self.setup.rear), ("front", self.setup.front)):
            try:
                position = self._position(module, once, counts, estimate.pose)
                self._check_jump(name, position, time)
                positions[name] = position
            except HiddenError as reason:
                reasons.append(f"{name} marker {reason}")
        rear, front = positions["rear"], positions["front"]
        return TrackedPositions(time, rear, front, "; ".join(reasons), event, estimate.pose)

    def _misfit_event(self, pose: CameraPose) -> str:
        """Return a message the first time that the reference markers fit their positions poorly; empty otherwise."""
        if self._misfit_reported or pose.error_m < DOUBTFUL:
            return ""
        self._misfit_reported = True
        return (
            f"the reference markers are {pose.error_m * 1e3:.2f} mm ({pose.error:.1f} px) from their positions in the "
            "setup file. x1 and x2 may be wrong by some mm: measure the positions again, or repeat the calibration"
        )

    def _position(
        self,
        module: ModuleMarker,
        once: dict[int, Detection],
        counts: Counter[int],
        pose: CameraPose,
    ) -> float:
        """Return the position (m) of a module's fin root in one image. Raises HiddenError."""
        number = module.number
        if counts[number] > 1:
            raise HiddenError(f"{number} is visible {counts[number]} times")
        if number not in once:
            raise HiddenError(f"{number} is not found")
        try:
            position = locate(self.setup, self.camera, pose, once[number])
        except HiddenError as reason:
            raise HiddenError(f"{number} is {reason}") from None
        return position + module.offset - self.setup.origin

    def _check_jump(self, name: str, position: float, time: float) -> None:
        """Raise HiddenError unless a module can have moved there since its last accepted position."""
        before, where = self._last.get(name, (-math.inf, position))
        jump, elapsed = abs(position - where), time - before
        # After the clock was set back, the elapsed time is unknown and the position is accepted.
        if elapsed >= 0.0 and jump > _PLAY + _MAX_SPEED * elapsed:
            raise HiddenError(
                f"is {jump * 1e3:.0f} mm from where it was {elapsed * 1e3:.0f} ms before"
            )
        self._last[name] = (time, position)


_OFTEN = 0.1  # share of images with a hidden module above which the level is WARN


class TrackerReport:
    """Counters of the images between two reports."""

    def __init__(self, source: str):
        self._source = source
        self._images = 0
        self._hidden: Counter[str] = Counter()
        self._error = math.nan
        self._event = ""
        self._problem = "no image yet"

    def count(self, sample: TrackedPositions) -> None:
        """Add the result of one image."""
        self._images += 1
        self._problem = ""
        if sample.reason:
            self._hidden[sample.reason] += 1
        if sample.event:
            self._event = sample.event
        if sample.pose is not None:
            self._error = sample.pose.error

    def set_problem(self, problem: str) -> bool:
        """Store why images cannot be used; return True if the problem is new."""
        new = problem != self._problem
        self._problem = problem
        return new

    def next_report(self) -> DiagnosticReport:
        """Return the report on the images since the last one, and reset the counters."""
        hidden = sum(self._hidden.values())
        level, message = Level.OK, "ok"
        if self._problem:
            level, message = Level.ERROR, self._problem
        elif not self._images:
            level, message = Level.ERROR, "no image in the last second: is the camera running?"
        elif self._event:
            level, message = Level.WARN, self._event
        elif hidden > _OFTEN * self._images:
            level = Level.WARN
            message = f"a module is hidden in {hidden} of {self._images} images: {self._hidden.most_common(1)[0][0]}"
        values = (
            ("images", str(self._images)),
            ("hidden", str(hidden)),
            ("reprojection_error_px", f"{self._error:.3f}"),
        )
        self._images, self._event = 0, ""
        self._hidden.clear()
        return DiagnosticReport("tracker: camera", level, message, self._source, values)
