# SPDX-License-Identifier: Apache-2.0
"""Detection of faults, once per cycle: silence, overload, following errors, registers, positions and lateness."""

import math
import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

from worm_driver.control.actuators import Actuators, CableLength, fault_level
from worm_driver.gait.gait_player import PlayerState, moving
from worm_driver.servos.registers import WATCHDOG_EXPIRED, hardware_error_text
from worm_driver.servos.state_reader import SILENT, ServoState, StateReader

#: Consecutive cycles with an overload or with too large a following error that are a fault.
_FAULTY_CYCLES = 5
#: Time for which a cable is contracted, although it is commanded to rest, that is a fault, s.
_UNRESTED = 1.0
#: Time for which the loop's own lateness explains an expired bus watchdog, s. It is longer than a cycle, because
#: each cycle examines one suspect servo only.
_REMEMBERED = 0.5


@dataclass(frozen=True)
class ServoHealth:
    """Registers that show whether a servo still has the settings that the driver wrote.

    Attributes:
        torque: torque_enable, raw.
        led: led, raw. The home mark of a cable servo.
        hardware_error: hardware_error_status, raw.
        watchdog: bus_watchdog, raw. 0: not armed; WATCHDOG_EXPIRED: expired.
    """

    torque: int
    led: int
    hardware_error: int
    watchdog: int


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
        """Reset the durations of all deviations. Call this method when the torque has just been enabled."""
        # By servo id: time without a state (s), cycles with overload and with too large a following error, and time for
        # which a cable has been contracted although it is commanded to rest (s).
        self._silence: Mapping[int, float] = {}
        self._overload: dict[int, int] = {}
        self._following: Mapping[int, float] = {}
        self._unrested: Mapping[int, float] = {}
        self._cables: Mapping[int, CableLength] = {}  # in the present cycle
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
        """Update the durations of the servos' silence from their states, whether the torque is on or off.

        Even if no servo answers, two readings of a punctual driver are at most two periods apart. Any further time is
        the driver's own lateness, in which it sent no request.
        """
        silent = (
            servo.number
            for servo, state in zip(self._actuators.servos, states, strict=True)
            if state is SILENT
        )
        ended = self._clock()
        watched = min(ended - self._last_look, 2.0 * self._actuators.settings.period)
        self._silence = _longer(self._silence, silent, watched)
        self._last_look = ended

    def fault(self, states: tuple[ServoState, ...], player: PlayerState) -> str | None:
        """Return the present fault as a message, or None. Call `note_silence` first.

        Args:
            states: states of the servos while the torque is on.
            player: state of the player with the present command.
        """
        if reason := self.fault_of_servo():
            return reason
        self._count_deviations(states, player)
        return self._fault_of_deviation()

    def fault_of_servo(self) -> str | None:
        """Return a fault that the registers or the position of a servo show, as a message, or None."""
        return self._fault_of_suspect() or self._fault_of_position()

    def _lateness(self) -> str:
        return (
            f"the control loop began no cycle for {self._away * 1e3:.0f} ms, and the servos stop by their watchdog "
            f"after {self._actuators.settings.watchdog * 1e3:.0f} ms: the computer was busy (load {self._load():.1f}) "
            "or the driver was suspended"
        )

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
            return None  # `note_silence` counts a servo that does not answer
        health = ServoHealth(*(registers[name] for name in names))
        is_cable = servo in robot.cables
        robot.homed = robot.homed and not (is_cable and not health.led)
        if health.watchdog == WATCHDOG_EXPIRED and self._clock() - self._away_at < _REMEMBERED:
            return self._lateness()
        return fault_in_health(servo.number, health, is_cable=is_cable)

    def _fault_of_position(self) -> str | None:
        """Return the fault of a servo whose position jumped.

        Its turn count or its encoder is wrong, so a cable servo is no longer homed.
        """
        robot = self._actuators
        lost = robot.track.lost
        robot.homed = robot.homed and not any(servo.number in lost for servo in robot.cables)
        for servo, jump in lost.items():
            return (
                f"the position of servo {servo} jumped by {jump} ticks, in the second of two implausible readings: the "
                "servo cannot have turned so far, so its turn count or its encoder is wrong"
            )
        return None

    def _count_deviations(self, states: tuple[ServoState, ...], player: PlayerState) -> None:
        robot, limits = self._actuators, self._actuators.settings
        for servo, state in zip(robot.cables, states, strict=False):
            if state is not SILENT:
                overloaded = abs(state.effort) > fault_level(servo, limits)
                cycles = self._overload.get(servo.number, 0) + 1 if overloaded else 0
                self._overload[servo.number] = cycles
        self._cables = cables = robot.cable_lengths(states, player.length_change)
        most = limits.max_following_error
        # An unknown length is NaN, and counts as no error.
        off = (n for n, at in cables.items() if abs(at.measured - at.commanded) > most)
        self._following = _longer(self._following, off, 1)
        returned = moving(player) and player.length_change == 0.0
        self._unrested = _longer(
            self._unrested, robot.contracted if returned else (), limits.period
        )

    def _fault_of_deviation(self) -> str | None:
        limits = self._actuators.settings
        for number, duration in self._silence.items():
            if duration >= limits.max_silence:
                why = self._reader.problems.get(number, "does not answer")
                return (
                    f"servo {number} has returned no state for {duration * 1e3:.0f} ms: it {why}"
                    f"{crowding(self._load(), os.cpu_count() or 1)}"
                )
        for number, cycles in self._overload.items():
            if cycles >= _FAULTY_CYCLES:
                return (
                    f"servo {number} is beyond its limit (limits.max_servo_current_a, limits.max_servo_load): the "
                    "cable is blocked or overloaded"
                )
        for number, lagging in self._following.items():
            if lagging >= _FAULTY_CYCLES:
                when = (
                    f"beyond limits.max_following_error_m ({limits.max_following_error * 1e3:g} mm)"
                )
                why = ", or the limit is too small for a loaded servo at this rate_hz"
                return _off_command(number, self._cables[number], when, why)
        for number, duration in self._unrested.items():
            if duration >= _UNRESTED:
                return _off_command(number, self._cables[number], "although it should be at rest")
        return None


def _longer(
    durations: Mapping[int, float], servos: Iterable[int], step: float
) -> Mapping[int, float]:
    """Return the durations after a further step in which these servos, by id, deviate, and no others."""
    return {number: durations.get(number, 0.0) + step for number in servos}


def crowding(load: float, cores: int) -> str:
    """Return a possible cause of silence if the load average exceeds the number of cores, else an empty string.

    The kernel forwards the bytes of a serial line in a thread without real-time priority, even if the servo thread has
    real-time priority.
    """
    if load <= cores:
        return ""
    return f"; or this busy computer delays its answers (load {load:.1f} on {cores} cores)"


def _off_command(servo: int, cable: CableLength, when: str, otherwise: str = "") -> str:
    measured, commanded = cable.measured * 1e3, cable.commanded * 1e3
    return (
        f"the cable of servo {servo} is {abs(measured - commanded):.1f} mm off its command (at {measured:.1f} mm "
        f"instead of {commanded:.1f} mm), {when}: it is blocked, its servo is too slow or too weak, or its position is "
        f"wrong{otherwise}"
    )


def fault_in_health(servo: int, health: ServoHealth, *, is_cable: bool) -> str | None:
    """Return the fault that a servo's health registers show while its torque should be on, as a message, or None."""
    if health.hardware_error:
        return f"servo {servo} reports {hardware_error_text(health.hardware_error)}"
    if health.watchdog == WATCHDOG_EXPIRED:
        return f"the bus watchdog of servo {servo} has expired: the command stream was interrupted"
    if health.torque and health.watchdog and (health.led or not is_cable):
        return None
    armed = "on" if health.watchdog else "on, without its bus watchdog"
    torque = f"its torque is {armed if health.torque else 'off'}"
    if is_cable and not health.led:
        return f"servo {servo} has restarted: {torque}, and its turn count is lost"
    if not (is_cable or health.torque or health.watchdog):
        return f"servo {servo} has restarted: {torque}"
    return f"servo {servo} was changed by another program, as it has not restarted: {torque}"
