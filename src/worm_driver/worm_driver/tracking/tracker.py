# SPDX-License-Identifier: Apache-2.0
"""From the markers in one image after another to x1 and x2: a position, or NaN with a reason."""

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

#: m, that a marker may jump from image to image whatever its speed: noise, and a module's play in the pipe
_PLAY = 0.003


@dataclass(frozen=True)
class TrackedPositions:
    """What an image tells.

    Attributes:
        time: of the exposure, s.
        rear, front: x1 and x2, roots of the fins from the first reference marker along +x, m; NaN while hidden.
        reason: why something is NaN; empty when both are seen.
        news: what is to be told once, such as that the camera was moved; most often empty.
        pose: of the camera, None where it cannot be told.
    """

    time: float
    rear: float
    front: float
    reason: str = ""
    news: str = ""
    pose: CameraPose | None = None

    @property
    def length(self) -> float:
        """Distance of the fin roots (m); NaN while a marker is hidden."""
        return self.front - self.rear


class Tracker:
    """Follows both modules through images that come in the order of their times.

    Args:
        setup: the rig.
        camera: its calibration, which the setup may leave to the images' topic.
    """

    def __init__(self, setup: TrackerSetup, camera: CameraModel | None = None):
        model = setup.camera or camera
        if model is None:
            raise SetupError("camera_info: topic works in tracker_node alone: name a file")
        self.setup = setup
        self.camera = model
        kind = FixedCamera if setup.pose == "fixed" else MovingCamera
        self._place = kind(setup, model)
        self._doubted = False
        self._last: dict[str, tuple[float, float]] = {}

    def see(self, detections: Sequence[Detection], stamp: float) -> TrackedPositions:
        """The sample of an image with these markers, stamped at a time (s)."""
        time = stamp - self.setup.delay
        counts = Counter(detection.number for detection in detections)
        once = {d.number: d for d in detections if counts[d.number] == 1}
        sharp = {n for n, detection in once.items() if detection.edge_width <= BLURRED}
        references = {n: once[n].corners for n in self.setup.reference if n in sharp}
        watch = self._place.look(references)
        if watch.pose is None:
            return TrackedPositions(time, math.nan, math.nan, watch.problem, watch.news)
        news = watch.news or self._doubt(watch.pose)
        fixes = {}
        for name, module in (("rear", self.setup.rear), ("front", self.setup.front)):
            fix = self._fix(module, once, counts, watch.pose)
            fixes[name] = self._believed(name, fix, time)
        reasons = [f"{name} marker {fix.reason}" for name, fix in fixes.items() if fix.reason]
        positions = fixes["rear"].position, fixes["front"].position
        return TrackedPositions(time, *positions, "; ".join(reasons), news, watch.pose)

    def _doubt(self, pose: CameraPose) -> str:
        """Told once where the reference markers fit their places less well than markers can."""
        if self._doubted or pose.error_m < DOUBTFUL:
            return ""
        self._doubted = True
        return (
            f"the reference markers lie {pose.error_m * 1e3:.2f} mm ({pose.error:.1f} px) beside the places of the "
            "setup file, which may put x1 and x2 off by some mm: measure the places again, or calibrate anew"
        )

    def _fix(
        self,
        module: ModuleMarker,
        once: dict[int, Detection],
        counts: Counter[int],
        pose: CameraPose,
    ) -> Fix:
        """The root of a module's fins, before its past is looked at."""
        if counts[module.number] > 1:
            return Fix(math.nan, f"{module.number} is there {counts[module.number]} times")
        if module.number not in once:
            return Fix(math.nan, f"{module.number} is not found")
        fix = locate(self.setup, self.camera, pose, once[module.number])
        if fix.reason:
            return Fix(math.nan, f"{module.number} is {fix.reason}")
        return Fix(fix.position + module.offset - self.setup.origin)

    def _believed(self, name: str, fix: Fix, time: float) -> Fix:
        """A fix, unless the module cannot have come there since it was last seen."""
        if fix.reason:
            return fix
        before, where = self._last.get(name, (-math.inf, fix.position))
        jump = abs(fix.position - where)
        elapsed = time - before
        # A clock that was set back tells nothing about speed.
        if elapsed >= 0.0 and jump > _PLAY + self.setup.max_speed * elapsed:
            return Fix(
                math.nan, f"is {jump * 1e3:.0f} mm from where it was {elapsed * 1e3:.0f} ms before"
            )
        self._last[name] = (time, fix.position)
        return fix
