# SPDX-License-Identifier: Apache-2.0
"""State on which the rules of `supervision` depend.

The state contains the durations of silence, overload and following errors, and the lateness of the control loop.
"""

import math
import os
from collections.abc import Callable

from worm_driver.control import supervision
from worm_driver.control.actuators import Actuators
from worm_driver.control.supervision import Counts, ServoHealth, fault_level
from worm_driver.gait.gait_player import PlayerState, moving
from worm_driver.servos.registers import WATCHDOG_EXPIRED
from worm_driver.servos.state_reader import SILENT, ServoState, StateReader

#: Time for which the loop's own lateness explains an expired bus watchdog, s. It is longer than a cycle, because
#: each cycle examines one suspect servo only.
_REMEMBERED = 0.5


class FaultWatch:
    """Fault detection, evaluated once per cycle. A lost turn count sets `Actuators.homed` to False.

    Args:
        actuators: the servos.
        reader: reader of their states.
        clock: returns the time, s, monotonic.
        load: returns the computer's load average.
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
        """Reset all counts. Call this method when the torque has just been enabled."""
        self._counts = Counts()
        self._away, self._away_at = 0.0, -math.inf
        self._last_step = self._clock()

    def step(self, now: float) -> str:
        """Record the start of a cycle at a time (s).

        Return a message if more time than the bus watchdog has passed since the start of the previous cycle, else an
        empty string.
        """
        gap = now - self._last_step
        self._last_step = max(now, self._last_step)
        watchdog = self._actuators.settings.watchdog
        if gap > watchdog / 2:
            self._away, self._away_at = gap, now
        return self._lateness() if gap > watchdog else ""

    def note_silence(self, states: tuple[ServoState, ...]) -> None:
        """Update the durations of the servos' silence from their states, whether the torque is on or off."""
        silent = (
            servo.number
            for servo, state in zip(self._actuators.servos, states, strict=True)
            if state is SILENT
        )
        ended = self._clock()
        watched = supervision.watched_time(ended - self._last_look, self._actuators.settings.period)
        self._counts = supervision.silence(self._counts, silent, watched)
        self._last_look = ended

    def fault(self, states: tuple[ServoState, ...], player: PlayerState) -> str | None:
        """Return the present fault as a message, or None. Call `note_silence` first.

        Args:
            states: states of the servos while the torque is on.
            player: state of the player with the present command.
        """
        return self.fault_of_servo() or self._fault_in_counts(states, player)

    def fault_of_servo(self) -> str | None:
        """Return a fault that the registers or the position of a servo show, as a message, or None."""
        return self._fault_of_suspect() or self._fault_of_position()

    def _lateness(self) -> str:
        return supervision.lateness(self._away, self._actuators.settings.watchdog, self._load())

    def _fault_of_suspect(self) -> str | None:
        """Read the health registers of a suspect servo again and return a fault that they show.

        If the loop was late shortly before, this explains an expired bus watchdog. The message is then about the
        lateness. Only one servo per cycle is read, to keep the cycle short.
        """
        robot = self._actuators
        suspect = self._reader.pop_suspect()
        servo = next((servo for servo in robot.servos if servo.number == suspect), None)
        if servo is None:
            return None
        names = ("torque_enable", "led", "hardware_error_status", "bus_watchdog")
        registers = self._reader.reread_health(servo, names)
        if registers is None:
            return None  # `supervision.silence` counts a servo that does not answer
        health = ServoHealth(*(registers[name] for name in names))
        is_cable = servo in robot.cables
        robot.homed = robot.homed and not (is_cable and not health.led)
        if health.watchdog == WATCHDOG_EXPIRED and self._clock() - self._away_at < _REMEMBERED:
            return self._lateness()
        return supervision.fault_in_health(servo.number, health, is_cable=is_cable)

    def _fault_of_position(self) -> str | None:
        """Return the fault of a servo whose position jumped.

        Its turn count or its encoder is wrong, so a cable servo is no longer homed.
        """
        robot = self._actuators
        lost = robot.track.lost
        robot.homed = robot.homed and not any(servo.number in lost for servo in robot.cables)
        return next((supervision.position_jumped(*jump) for jump in lost.items()), None)

    def _fault_in_counts(self, states: tuple[ServoState, ...], player: PlayerState) -> str | None:
        robot, limits = self._actuators, self._actuators.settings
        efforts = {
            servo.number: state.effort
            for servo, state in zip(robot.cables, states, strict=False)
            if state is not SILENT
        }
        levels = {servo.number: fault_level(servo, limits) for servo in robot.cables}
        counts = supervision.overload(self._counts, efforts, levels)
        cables = robot.cable_lengths(states, player.length_change)
        counts = supervision.following(counts, cables, limits)
        returned = moving(player) and player.length_change == 0.0
        unrested = robot.contracted if returned else ()
        self._counts = supervision.resting(counts, unrested, robot.settings.period)
        problems = self._reader.problems
        if supervision.fault_in_counts(self._counts, limits, problems) is None:
            return None  # the load average is read only for a fault, not in every cycle
        crowding = supervision.crowding(self._load(), os.cpu_count() or 1)
        return supervision.fault_in_counts(self._counts, limits, problems, crowding)
