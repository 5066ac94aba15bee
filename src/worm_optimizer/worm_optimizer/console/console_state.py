# SPDX-License-Identifier: Apache-2.0
"""State that all pages of the console share."""

from __future__ import annotations

import math
import time
from collections import deque
from dataclasses import dataclass, field

from worm_model.gait import FORWARD
from worm_model.parameters import Parameters
from worm_model.run import LengthSource
from worm_model.twin.run_margins import spare_of
from worm_msgs.conditions import LEVEL, Conditions
from worm_optimizer.console.bag_library import BagLibrary
from worm_optimizer.console.control import ConsoleControl
from worm_optimizer.console.picture import picture
from worm_optimizer.console.robot_worker import Notice, RobotWorker
from worm_optimizer.console.view import History, is_live, live_twin, sample
from worm_optimizer.gait_prediction import Prediction
from worm_optimizer.snapshot import Snapshot

_FRESH_S = 0.02  # time for which all pages share a snapshot, s
_NOTICES = 50  # largest number of stored messages


@dataclass
class ConsoleState:
    """Shared state. All pages use it in one thread, that of the web server.

    Commands in the worker's command thread change ``fronts``, ``conditions``, ``parameters`` and ``parameter_file``.
    Both threads of the worker append to ``notices``, too.

    Attributes:
        worker: threads that operate the robot.
        control: requests of the pages for control, and which page has control.
        library: folder of recordings.
        parameters: parameters in use.
        parameter_file: path of the file with these parameters; empty: the paper's values.
        notices: messages, the newest last.
        fronts: gaits of the displayed front, by direction.
        conditions: conditions in the pipe that the optimizer assumes, as the console last read or set them.
        history: values of the last minute, and grooves of each cycle of the present run.
    """

    worker: RobotWorker
    control: ConsoleControl
    library: BagLibrary
    parameters: Parameters
    parameter_file: str
    notices: deque[Notice]
    fronts: dict[int, list[Prediction]] = field(default_factory=dict)
    conditions: Conditions = LEVEL
    history: History = field(default_factory=lambda: History(time.monotonic))
    _latest: tuple[float, Snapshot] = (-math.inf, Snapshot())
    _drawn: tuple[Snapshot | None, str] = (None, "")

    def snapshot(self) -> Snapshot:
        """Return the latest state of the robot."""
        now = time.monotonic()
        if now - self._latest[0] > _FRESH_S:
            self._latest = (now, self.worker.snapshot())
            self.control.update(self._latest[1].control)
        return self._latest[1]

    def picture(self) -> str:
        """Return a picture of the robot in its pipe. All pages share the picture of a snapshot."""
        snapshot = self.snapshot()
        if snapshot is not self._drawn[0]:
            driver = snapshot.driver
            direction = driver.direction if driver is not None and driver.direction else FORWARD
            twin = live_twin(snapshot, time.monotonic())
            drawn = picture(twin, snapshot.robot_at_twin, self.parameters, direction)
            self._drawn = (snapshot, drawn)
        return self._drawn[1]

    def cancellation(self) -> str:
        """Return the reason why the present run must end; empty if it may continue."""
        return self.worker.cancellation or self.control.run_loss

    def status_text(self) -> str:
        """Return the text of a pending STOP, else of the present command, else of the latest message."""
        if self.worker.stopping:
            return "STOP: waiting for the driver"
        return self.worker.busy or (self.notices[-1].text if self.notices else "")

    def numbers(self, now: float) -> dict[str, str]:
        """Return the values in the table of the Live tab as texts, by name; a dash for a value that is unavailable.

        Args:
            now: present time of the monotonic clock, s.
        """
        snapshot = self.snapshot()
        newest = sample(snapshot, now)
        names = (source.name.lower() for source in LengthSource)
        lengths = {f"{name} length": _millimetres(getattr(newest, name)) for name in names}
        twin = live_twin(snapshot, now)
        residuals = snapshot.residuals if is_live(snapshot, "twin/residuals", now) else None
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
            "measured margin": ("" if twin is None else spare_of(twin)) or "–",
        }


def new_notices() -> deque[Notice]:
    """Return an empty list of messages, which stores only the newest `_NOTICES`."""
    return deque(maxlen=_NOTICES)


def _millimetres(value: float) -> str:
    return f"{1e3 * value:.1f} mm" if math.isfinite(value) else "–"


def _watts(value: float) -> str:
    return f"{value:.2f} W" if math.isfinite(value) else "–"
