# SPDX-License-Identifier: Apache-2.0
"""Keeps what `supervision` judges by: how long servos are silent or overloaded, and how late the loop itself was."""

import math
import os
from collections.abc import Callable

from worm_driver.control import supervision
from worm_driver.control.actuators import Actuators
from worm_driver.control.supervision import Counts, Health
from worm_driver.control.telemetry import SILENT, ServoState
from worm_driver.servos import servo_setup as servos
from worm_driver.servos.registers import WATCHDOG_EXPIRED
from worm_driver.servos.state_reader import StateReader

#: s, for which the loop's own lateness explains a bus watchdog that has expired: health is read in turn
_REMEMBERED = 0.5


class FaultWatch:
    """Looks once in each cycle whether the robot may go on; a turn count that is lost takes its actuators' home.

    ``clock`` tells s, monotonic; ``load`` the computer's load average.
    """

    def __init__(
        self,
        actuators: Actuators,
        reader: StateReader,
        clock: Callable[[], float],
        load: Callable[[], float],
    ):
        self._actuators = actuators
        self._reader = reader
        self._clock = clock
        self._load = load
        self._last_look = -math.inf
        self.begin()

    def begin(self) -> None:
        """Nothing has been odd so far: the torque was enabled just now."""
        self._counts = Counts()
        self._away, self._away_at = 0.0, -math.inf
        self._last_step = self._clock()

    def step(self, now: float) -> str:
        """Takes the start of a cycle (s); what to say of a loop later than the watchdog, else nothing."""
        gap = now - self._last_step
        self._last_step = max(now, self._last_step)
        watchdog = self._actuators.settings.watchdog
        if gap > watchdog / 2:
            self._away, self._away_at = gap, now
        return self._lateness() if gap > watchdog else ""

    def look(self, states: tuple[ServoState, ...]) -> None:
        """Takes what was read, whether the torque is on or not."""
        silent = (
            servo.number
            for servo, state in zip(self._actuators.servos, states, strict=True)
            if state is SILENT
        )
        ended = self._clock()
        watched = supervision.watched_time(ended - self._last_look, self._actuators.settings.period)
        self._counts = supervision.silence(self._counts, silent, watched)
        self._last_look = ended

    def fault(
        self, before: tuple[ServoState, ...], states: tuple[ServoState, ...], length_change: float
    ) -> str | None:
        """The fault, in words, that there is after `look`; the torque is on, and ΔL (m) is commanded."""
        return (
            self._fault_of_suspect()
            or self._fold(before, states)
            or self._fault_in_counts(states, length_change)
        )

    def _lateness(self) -> str:
        return supervision.lateness(self._away, self._actuators.settings.watchdog, self._load())

    def _fault_of_suspect(self) -> str | None:
        """Looks again at a servo whose answers were odd, on a quiet line; at one per cycle, to keep it short."""
        robot = self._actuators
        suspect = self._reader.take_suspect()
        servo = next((servo for servo in robot.servos if servo.number == suspect), None)
        if servo is None:
            return None
        names = ("torque_enable", "led", "hardware_error_status", "bus_watchdog")
        registers = self._reader.look(servo, names)
        if registers is None:
            return None  # a servo that does not answer is counted as such
        health = Health(*(registers[name] for name in names))
        is_cable = servo in robot.cables
        robot.homed = robot.homed and not (is_cable and not health.led)
        if health.watchdog == WATCHDOG_EXPIRED and self._clock() - self._away_at < _REMEMBERED:
            return self._lateness()
        return supervision.fault_in_health(servo.number, health, is_cable=is_cable)

    def _fold(self, before: tuple[ServoState, ...], states: tuple[ServoState, ...]) -> str | None:
        for servo, old, new in zip(self._actuators.cables, before, states, strict=False):
            if old is SILENT or new is SILENT:
                continue
            elapsed = (new.tick - old.tick) % 32.768
            if supervision.turn_count_jumped(old.ticks, new.ticks, elapsed, servo.velocity_limit):
                self._actuators.homed = False
                return f"the turn count of servo {servo.number} jumped by {new.ticks - old.ticks} ticks"
        return None

    def _fault_in_counts(self, states: tuple[ServoState, ...], length_change: float) -> str | None:
        robot, limits = self._actuators, self._actuators.settings.limits
        efforts = {
            servo.number: state.effort
            for servo, state in zip(robot.cables, states, strict=False)
            if state is not SILENT
        }
        levels = {servo.number: servos.fault_level(servo, limits) for servo in robot.cables}
        counts = supervision.overload(self._counts, efforts, levels)
        error = robot.length_change(states) - length_change
        self._counts = supervision.following(counts, error, limits)
        problems = self._reader.problems
        if supervision.fault_in_counts(self._counts, limits, problems) is None:
            return None  # the load is read for a fault alone, not a hundred times a second
        crowding = supervision.crowding(self._load(), os.cpu_count() or 1)
        return supervision.fault_in_counts(self._counts, limits, problems, crowding)
