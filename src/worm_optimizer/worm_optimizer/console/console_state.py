# SPDX-License-Identifier: Apache-2.0
"""State that all pages of the console share."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field

from worm_model.gait import FORWARD
from worm_model.parameters import Parameters
from worm_model.twin.data.records import StateRecord
from worm_msgs.conditions import LEVEL, Conditions
from worm_optimizer.console.bag_library import BagLibrary
from worm_optimizer.console.control import PageControl
from worm_optimizer.console.gait_fields import LIMITS
from worm_optimizer.console.page_actions import Front
from worm_optimizer.console.picture import picture
from worm_optimizer.console.robot_worker import Notice, RobotWorker
from worm_optimizer.console.view import HISTORY_S, SAMPLE_S, live_twin, sample
from worm_optimizer.robot_commands import Snapshot

_FRESH_S = 0.02  # time for which all pages share a snapshot, s


@dataclass
class ConsoleState:
    """Shared state. All pages use it in one thread, that of the web server.

    Commands in the worker's command thread change ``fronts``, ``front_notes``, ``limits`` and ``conditions``. Both
    threads of the worker append to ``notices``, too.

    Attributes:
        worker: threads that operate the robot.
        control: decides which page has control.
        library: folder of recordings.
        parameters: parameters of the robot.
        parameter_file: path of the file with these parameters; empty: the paper's values.
        notices: messages, the newest last.
        fronts: fronts, by direction.
        front_notes: what there is to say about the front of a direction, or why there is none.
        limits: the driver's limits on gaits, see `LIMITS`; without any until they are read.
        conditions: conditions in the pipe that the optimizer assumes, as the console last read or set them.
        samples: values of the last minute.
    """

    worker: RobotWorker
    control: PageControl
    library: BagLibrary
    parameters: Parameters
    parameter_file: str
    notices: deque[Notice]
    fronts: dict[int, Front] = field(default_factory=dict)
    front_notes: dict[int, str] = field(default_factory=dict)
    limits: Sequence[float] = (math.inf,) * len(LIMITS)
    conditions: Conditions = LEVEL
    samples: deque[dict[str, float]] = field(
        default_factory=lambda: deque(maxlen=round(HISTORY_S / SAMPLE_S))
    )
    _latest: tuple[float, Snapshot] = (-math.inf, Snapshot())

    def snapshot(self) -> Snapshot:
        """Return the latest state of the robot."""
        now = time.monotonic()
        if now - self._latest[0] > _FRESH_S:
            self._latest = (now, self.worker.snapshot())
            self.control.expire()
        return self._latest[1]

    def add_sample(self) -> None:
        """Add the present values to those of the last minute. Call this every `SAMPLE_S`."""
        self.samples.append(sample(self.snapshot(), time.monotonic()))

    def twin(self) -> StateRecord | None:
        """Return the state of the twin; None if it is silent."""
        return live_twin(self.snapshot(), time.monotonic())

    def picture(self) -> str:
        """Return a picture of the robot in its pipe."""
        snapshot = self.snapshot()
        driver = snapshot.driver
        direction = driver.direction if driver is not None and driver.direction else FORWARD
        return picture(self.twin(), snapshot.robot_at_twin, self.parameters, direction)

    def cancellation(self) -> str:
        """Return the reason why the present run must end; empty if it may continue."""
        return self.worker.cancellation or self.control.run_loss

    def message(self) -> Notice:
        """Return the text of a pending STOP, else of the present command, else the latest message."""
        if self.worker.stopping:
            return Notice("STOP: waiting for the driver")
        if self.worker.busy or not self.notices:
            return Notice(self.worker.busy)
        return self.notices[-1]
