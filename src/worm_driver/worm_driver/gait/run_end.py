# SPDX-License-Identifier: Apache-2.0
"""When a run has reached what it was asked for: after so many cycles, grooves, or so far along the pipe."""

import math
from dataclasses import dataclass

from worm_driver.errors import LimitError
from worm_driver.gait.gait_limits import Gait, GaitLimits
from worm_driver.gait.gait_metrics import RunRecord, distance
from worm_driver.gait.gait_player import Run

#: part of a cycle's extension after which x1 is where the cycle leaves it, except for the spring-back of the fins
_LATE = 0.8
#: part of a groove that may lack: beside whole grooves, x1 moves by what the fins bend, which is no groove
_NEARLY = 0.25
#: cycles after which a robot that has not gained a groove in them gains none
_CYCLES_WITHOUT_PROGRESS = 3
#: s after a cycle's end within which the tracker's word on it must have come
_LATENCY = 0.5


@dataclass(frozen=True)
class RunEnd:
    """What is asked for, the first that is reached counts; 0: does not matter.

    Attributes:
        grooves: that x1 gains along the gait's direction.
        distance: m, that x1 travels along the gait's direction.
    """

    cycles: int = 0
    grooves: int = 0
    distance: float = 0.0

    @property
    def needs_tracker(self) -> bool:
        """Whether it cannot be told without the tracker."""
        return self.grooves > 0 or self.distance > 0.0

    def most_cycles(self, gait: Gait, limits: GaitLimits) -> int:
        """After how many cycles the run ends in any case. Raises LimitError."""
        if not (math.isfinite(self.distance) and self.distance >= 0.0):
            raise LimitError(f"distance must be a length in m, not {self.distance:g}")
        if self.cycles:
            return self.cycles
        if not self.needs_tracker:
            raise LimitError("a run needs an end: cycles, grooves or distance must not be 0")
        return limits.most_cycles(gait)

    def is_reached(self, run: Run, record: RunRecord, pitch: float) -> bool:
        """Whether the run is to end with the present cycle, by the tracker's last word.

        Args:
            pitch: m, of the grooves.
        """
        travelled = distance(run, record)
        if not is_late(run, record) or math.isnan(travelled):
            return False
        by_grooves = 0 < self.grooves <= math.floor(travelled / pitch + _NEARLY)
        return by_grooves or 0.0 < self.distance <= travelled


def is_late(run: Run, record: RunRecord) -> bool:
    """Whether the tracker's last word is of the end of a cycle."""
    if run.onset is None or not record.positions or record.positions[-1][0] < run.onset:
        return False
    phase = (record.positions[-1][0] - run.onset) * run.gait.frequency % 1.0
    return run.gait.extended_share(phase) >= _LATE


def makes_no_progress(run: Run, record: RunRecord, pitch: float) -> bool:
    """Whether the robot gains nothing any more, by the tracker's last word, which is of the end of a cycle."""
    newest, before = record.positions[-1], _CYCLES_WITHOUT_PROGRESS / run.gait.frequency
    if run.onset is None or newest[0] - before < run.onset:
        return False
    gained = run.gait.direction * (newest[1] - record.position_at(newest[0] - before)[0])
    return gained < pitch / 2.0


def unseen_cycle(run: Run, judged: int, now: float) -> int:
    """The cycle whose end the tracker should have seen by now (s) but did not; 0 if there is none.

    Args:
        judged: the last cycle whose end it saw.
    """
    if run.onset is None:
        return 0
    ended = run.cycle(now - _LATENCY) - 1
    return ended if ended > judged else 0
