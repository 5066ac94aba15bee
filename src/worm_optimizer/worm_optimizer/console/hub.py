# SPDX-License-Identifier: Apache-2.0
"""What all pages share: one worker, one snapshot and picture a frame, one minute of history, one holder of control."""

from __future__ import annotations

import math
import time
from collections import deque
from dataclasses import dataclass, field

from worm_model.gait import FORWARD
from worm_model.parameters import Parameters
from worm_model.twin.records import LengthSource
from worm_optimizer.console.control import Control
from worm_optimizer.console.picture import picture
from worm_optimizer.console.robot_worker import Notice, RobotWorker
from worm_optimizer.console.shelf import Shelf
from worm_optimizer.console.view import History, live, sample
from worm_optimizer.robustness.prediction import Prediction
from worm_optimizer.snapshot import Snapshot

_FRESH_S = 0.02  # for which a snapshot serves all pages
_WORDS = 50


@dataclass
class Hub:
    """Used by the pages' thread alone, but for ``words``, to which the worker's threads append.

    ``parameter_file`` is empty for the paper's values; ``fronts`` are the gaits of each direction that were read.
    """

    worker: RobotWorker
    control: Control
    shelf: Shelf
    parameters: Parameters
    parameter_file: str
    words: deque[Notice]
    fronts: dict[int, list[Prediction]] = field(default_factory=dict)
    history: History = field(default_factory=lambda: History(time.monotonic))
    _taken: tuple[float, Snapshot] = (-math.inf, Snapshot())
    _drawn: tuple[Snapshot | None, str] = (None, "")

    def snapshot(self) -> Snapshot:
        """What is known now."""
        now = time.monotonic()
        if now - self._taken[0] > _FRESH_S:
            self._taken = (now, self.worker.snapshot())
        return self._taken[1]

    def picture(self) -> str:
        """The robot in its pipe now, drawn once for all pages."""
        snapshot = self.snapshot()
        if snapshot is not self._drawn[0]:
            heard = live(snapshot, "twin/state", time.monotonic())
            driver = snapshot.driver
            direction = driver.direction if driver is not None and driver.direction else FORWARD
            twin = snapshot.twin if heard else None
            self._drawn = (snapshot, picture(twin, snapshot.robot, self.parameters, direction))
        return self._drawn[1]

    def unwanted(self) -> str:
        """Why what runs is not wanted any more, empty: nobody has stopped it, and the page that holds control lives."""
        return self.worker.stopped or self.control.loss

    def numbers(self, now: float) -> dict[str, str]:
        """The table of the live page; a dash for what is silent."""
        snapshot = self.snapshot()
        newest = sample(snapshot, now)
        names = (source.name.lower() for source in LengthSource)
        lengths = {f"{name} length": _millimetres(getattr(newest, name)) for name in names}
        twin = snapshot.twin if live(snapshot, "twin/state", now) else None
        residuals = snapshot.residuals if live(snapshot, "twin/residuals", now) else None
        nan = math.nan
        return {
            **lengths,
            "measured power": _watts(newest.power),
            "predicted power": _watts(newest.predicted),
            "residual of x1": _millimetres(nan if residuals is None else residuals.rear_position),
            "residual of length": _millimetres(nan if residuals is None else residuals.length),
            "residual of power": _watts(nan if residuals is None else residuals.power),
            "groove phase": _millimetres(nan if twin is None else twin.groove_phase),
            "grooves per cycle": ", ".join(map(str, self.history.grooves[-8:])) or "–",
        }


def new_words() -> deque[Notice]:
    """What is told, the newest last."""
    return deque(maxlen=_WORDS)


def _millimetres(value: float) -> str:
    return f"{1e3 * value:.1f} mm" if math.isfinite(value) else "–"


def _watts(value: float) -> str:
    return f"{value:.2f} W" if math.isfinite(value) else "–"
