# SPDX-License-Identifier: Apache-2.0
"""End of a run: after a number of cycles or grooves, after a distance, or when its client sends no more heartbeats."""

import math
from dataclasses import dataclass

from worm_driver.driver_errors import RejectedError
from worm_driver.gait.gait_limits import GaitLimits
from worm_driver.gait.gait_metrics import RunRecord, distance
from worm_driver.gait.gait_player import PlayedRun
from worm_msgs.gait import Gait

#: part of the extension after which x1 hardly changes until the end of the cycle, because only the fins spring back
_NEAR_END = 0.8
#: part of a pitch by which the distance may fall short of a number of grooves, because the deflection of the fins also
#: moves x1
_TOLERANCE = 0.25
#: number of cycles over which progress is judged: a run that gains less than half a pitch in them makes no progress
_CYCLES_WITHOUT_PROGRESS = 3
#: s, time after the end of a cycle within which the tracker samples of the cycle arrive
_LATENCY = 0.5


@dataclass(frozen=True)
class RunEnd:
    """Requested end of a run. The condition that is met first ends the run. A value of 0 stands for no condition.

    Attributes:
        cycles: number of cycles.
        grooves: number of grooves that x1 gains along the gait's direction.
        distance: distance of x1 along the gait's direction, m.
    """

    cycles: int = 0
    grooves: int = 0
    distance: float = 0.0

    @property
    def needs_tracker(self) -> bool:
        """True if the end depends on the tracker."""
        return self.grooves > 0 or self.distance > 0.0

    def most_cycles(self, gait: Gait, limits: GaitLimits) -> int:
        """Return the number of cycles after which the run ends at the latest."""
        if not (math.isfinite(self.distance) and self.distance >= 0.0):
            raise RejectedError(f"distance is {self.distance:g} m; it must be 0 m or longer")
        if self.cycles:
            return self.cycles
        if not self.needs_tracker:
            raise RejectedError("a run needs an end: cycles, grooves or distance must not be 0")
        return limits.most_cycles(gait)

    def is_reached(self, run: PlayedRun, record: RunRecord, pitch: float) -> bool:
        """Return True if the run must end with the present cycle, because its grooves or its distance are reached.

        This is decided from the latest tracker sample, if it is near the end of a cycle.

        Args:
            run: run in progress.
            record: measurements of the run.
            pitch: distance between two grooves, m.
        """
        travelled = distance(run, record)
        if not is_near_cycle_end(run, record) or math.isnan(travelled):
            return False
        by_grooves = 0 < self.grooves <= math.floor(travelled / pitch + _TOLERANCE)
        return by_grooves or 0.0 < self.distance <= travelled


def is_near_cycle_end(run: PlayedRun, record: RunRecord) -> bool:
    """Return True if the latest tracker sample is from the last fifth of an extension."""
    if run.onset is None or not record.positions or record.positions[-1][0] < run.onset:
        return False
    phase = (record.positions[-1][0] - run.onset) * run.gait.frequency % 1.0
    return run.gait.extended_share(phase) >= _NEAR_END


def makes_no_progress(run: PlayedRun, record: RunRecord, pitch: float) -> bool:
    """Return True if the robot gained less than half a pitch in the last three cycles.

    Return False during the first three cycles, and if x1 three cycles ago is unknown. Call this function only if the
    latest tracker sample is near the end of a cycle (`is_near_cycle_end`).
    """
    newest, before = record.positions[-1], _CYCLES_WITHOUT_PROGRESS / run.gait.frequency
    if run.onset is None or newest[0] - before < run.onset:
        return False
    gained = run.gait.direction * (newest[1] - record.position_at(newest[0] - before)[0])
    return gained < pitch / 2.0


def unseen_cycle(run: PlayedRun, judged: int, now: float) -> int:
    """Return the number of the last cycle that ended at least 0.5 s ago if the tracker did not see its end; else 0.

    Args:
        run: run in progress.
        judged: number of the last cycle whose end the tracker saw.
        now: present time, s.
    """
    if run.onset is None:
        return 0
    ended = run.cycle(now - _LATENCY) - 1
    return ended if ended > judged else 0


#: Period of the checks, s.
PERIOD = 0.1


class HeartbeatMonitor:
    """Heartbeat monitor of one run. One thread may record heartbeats while another one checks them.

    The intervals between the checks add up to the silence, and a heartbeat resets it to 0. An interval counts as at
    most two periods. If it is longer, the driver itself was late, and heartbeats may wait in its queues.

    Args:
        timeout: heartbeat timeout, s; infinite if no heartbeats are required.
        now: present time, s, monotonic.
    """

    def __init__(self, timeout: float, now: float):
        self.timeout = timeout
        self._silence = 0.0
        self._last_check = now
        self._received = False

    def record(self) -> None:
        """Record a heartbeat."""
        self._received = True

    def is_silent(self, now: float) -> bool:
        """Return True if the heartbeat timeout has expired. Call it every PERIOD with the time (s, monotonic)."""
        watched = min(now - self._last_check, 2.0 * PERIOD)
        self._last_check = now
        self._silence = 0.0 if self._received else self._silence + watched
        self._received = False
        return self._silence > self.timeout


def shorter_timeout(requested: float, required: float) -> float:
    """Return the shorter of the goal's and the driver's heartbeat timeout, s.

    An argument of 0 stands for no timeout. If both are 0, the result is infinity.
    """
    return min((value for value in (requested, required) if value > 0.0), default=math.inf)
