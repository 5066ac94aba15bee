# SPDX-License-Identifier: Apache-2.0
"""Tracker that converts detected markers into x1 and x2, or NaN with a reason."""

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from worm_driver.tracking.camera_model import CameraModel
from worm_driver.tracking.camera_pose import DOUBTFUL, CameraPose, FixedCamera, MovingCamera
from worm_driver.tracking.module_position import BLURRED, Fix, locate
from worm_driver.tracking.tracker_setup import ModuleMarker, TrackerSetup
from worm_driver.tracking.tracking_errors import SetupError
from worm_driver.tracking.vision import Detection

#: Displacement between two images that is always accepted (m), because of noise and the play of a module in the pipe.
_PLAY = 0.003


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
        camera: calibrated camera; required if the setup contains none (camera_info: topic).

    Raises:
        SetupError: There is no calibrated camera.
    """

    def __init__(self, setup: TrackerSetup, camera: CameraModel | None = None):
        model = setup.camera or camera
        if model is None:
            raise SetupError(
                "camera_info: topic works only in tracker_node; name a camera_info file instead"
            )
        self.setup = setup
        self.camera = model
        kind = FixedCamera if setup.pose == "fixed" else MovingCamera
        self._pose_estimator = kind(setup, model)
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
        fixes = {}
        for name, module in (("rear", self.setup.rear), ("front", self.setup.front)):
            fix = self._fix(module, once, counts, estimate.pose)
            fixes[name] = self._plausible(name, fix, time)
        reasons = [f"{name} marker {fix.reason}" for name, fix in fixes.items() if fix.reason]
        positions = fixes["rear"].position, fixes["front"].position
        return TrackedPositions(time, *positions, "; ".join(reasons), event, estimate.pose)

    def _misfit_event(self, pose: CameraPose) -> str:
        """Return a message the first time that the reference markers fit their positions poorly; empty otherwise."""
        if self._misfit_reported or pose.error_m < DOUBTFUL:
            return ""
        self._misfit_reported = True
        return (
            f"the reference markers are {pose.error_m * 1e3:.2f} mm ({pose.error:.1f} px) from their positions in the "
            "setup file. x1 and x2 may be wrong by some mm: measure the positions again, or repeat the calibration"
        )

    def _fix(
        self,
        module: ModuleMarker,
        once: dict[int, Detection],
        counts: Counter[int],
        pose: CameraPose,
    ) -> Fix:
        """Return the position of a module's fin root without regard to earlier images."""
        if counts[module.number] > 1:
            return Fix(math.nan, f"{module.number} is visible {counts[module.number]} times")
        if module.number not in once:
            return Fix(math.nan, f"{module.number} is not found")
        fix = locate(self.setup, self.camera, pose, once[module.number])
        if fix.reason:
            return Fix(math.nan, f"{module.number} is {fix.reason}")
        return Fix(fix.position + module.offset - self.setup.origin)

    def _plausible(self, name: str, fix: Fix, time: float) -> Fix:
        """Return the fix if the module can have moved there since its last accepted position, else a rejected fix."""
        if fix.reason:
            return fix
        before, where = self._last.get(name, (-math.inf, fix.position))
        jump = abs(fix.position - where)
        elapsed = time - before
        # After the clock was set back, the elapsed time is unknown and the fix is accepted.
        if elapsed >= 0.0 and jump > _PLAY + self.setup.max_speed * elapsed:
            return Fix(
                math.nan, f"is {jump * 1e3:.0f} mm from where it was {elapsed * 1e3:.0f} ms before"
            )
        self._last[name] = (time, fix.position)
        return fix
