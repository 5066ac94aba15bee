# SPDX-License-Identifier: Apache-2.0
"""Diagnostic report of the tracker (REP 107), published once a second by its node. Needs no ROS."""

import math
from collections import Counter

from worm_driver.control.diagnostics import DiagnosticReport, Level
from worm_driver.tracking.tracker import TrackedPositions

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
