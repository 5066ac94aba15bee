# SPDX-License-Identifier: Apache-2.0
"""What the tracker says about itself once a second (REP 107), without ROS."""

import math
from collections import Counter

from worm_driver.control.diagnostics import Level, Report
from worm_driver.tracking.tracker import TrackedPositions

_OFTEN = 0.1  # share of images without both modules from where a warning is given


class TrackerReport:
    """Counts what happens between two reports."""

    def __init__(self, source: str):
        self._source = source
        self._images = 0
        self._hidden: Counter[str] = Counter()
        self._error = math.nan
        self._news = ""
        self._trouble = "no image yet"

    def count(self, sample: TrackedPositions) -> None:
        """Takes what an image told."""
        self._images += 1
        self._trouble = ""
        if sample.reason:
            self._hidden[sample.reason] += 1
        if sample.news:
            self._news = sample.news
        if sample.pose is not None:
            self._error = sample.pose.error

    def refuse(self, problem: str) -> bool:
        """Takes why images cannot be used; returns whether that is new."""
        new = problem != self._trouble
        self._trouble = problem
        return new

    def take(self) -> Report:
        """The report on what happened since the last one."""
        hidden = sum(self._hidden.values())
        level, message = Level.OK, "ok"
        if self._trouble:
            level, message = Level.ERROR, self._trouble
        elif not self._images:
            level, message = Level.ERROR, "no image in the last second: is the camera running?"
        elif self._news:
            level, message = Level.WARN, self._news
        elif hidden > _OFTEN * self._images:
            level = Level.WARN
            message = (
                f"hidden in {hidden} of {self._images} images: {self._hidden.most_common(1)[0][0]}"
            )
        values = (
            ("images", str(self._images)),
            ("hidden", str(hidden)),
            ("reprojection_error_px", f"{self._error:.3f}"),
        )
        self._images, self._news = 0, ""
        self._hidden.clear()
        return Report("tracker: camera", level, message, self._source, values)
