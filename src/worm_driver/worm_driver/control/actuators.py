# SPDX-License-Identifier: Apache-2.0
"""The servos of a robot with their spools and fins: checked, set up and moved, and what their states mean."""

import math
from collections.abc import Sequence

from worm_driver.control.driver_settings import DriverSettings
from worm_driver.control.telemetry import SILENT, ServoState
from worm_driver.errors import HomingError
from worm_driver.servos import servo_setup as servos
from worm_driver.servos.registers import COMMON
from worm_driver.servos.servo_bus import ServoBus
from worm_driver.servos.servo_setup import Servo

#: ticks, how near a fin must come to where it was sent
_FIN_TOLERANCE = 40
#: rad/s, below which a fin stands still
_FIN_STILL = 0.1
#: m, closer to its initial length a robot that is let go does not spring back to speak of
_SPRINGS_BACK = 2e-3


class Actuators:
    """Servos that have answered and are set up, with the torque off.

    A contracted robot that an earlier driver left with its torque on keeps it, as it would spring back: see left_on.

    Attributes:
        settings: of this robot, until others are set.
        cables: the servos of the spools, in the order of the settings.
        fins: those of the fins.
        homed: whether the cable servos count their turns from the initial length.
        unreleased: what failed at the last release, in words: a servo may still have its torque.
        left_on: what there is to say of a torque that an earlier driver left on; empty: there is none.

    Raises:
        BusError: a servo does not answer.
        ConfigurationError: a servo is not what the settings say.
    """

    def __init__(self, settings: DriverSettings, bus: ServoBus):
        self.settings = settings
        self.unreleased: list[str] = []
        self.left_on = ""
        self._bus = bus
        self._hold_ticks: dict[int, int] = {}
        with bus.patient():
            self.cables = tuple(servos.identify(bus, spool.servo) for spool in settings.spools)
            self.fins = tuple(servos.identify(bus, fin.servo) for fin in settings.fins)
            self._set_up()

    def _set_up(self) -> None:
        for servo in self.servos:
            servos.check(self._bus, servo)
        for servo in self.fins:
            servos.prepare_fin(self._bus, servo)
        contraction = self._held_contraction()
        if contraction is not None:
            self.homed = True
            self.left_on = (
                f"the torque is on, as an earlier driver left it, with the robot contracted by "
                f"{contraction * 1e3:.1f} mm: it would spring back if it were let go; activate to take it over, "
                "then deactivate to bring it to rest"
            )
            return
        for servo in self.cables:
            servos.prepare_cable(self._bus, servo, servos.own_limit(servo, self.settings.limits))
        self.homed = all(servos.is_homed(self._bus, servo) for servo in self.cables)
        if self.settings.home_at_start and not self.homed:
            self.home()

    def _held_contraction(self) -> float | None:
        """By how much (m) servos that were left with their torque on hold the robot contracted; None if they do not."""
        longest = 0.0
        for spool, servo in zip(self.settings.spools, self.cables, strict=True):
            limit = servos.own_limit(servo, self.settings.limits)
            ticks = servos.held_position(self._bus, servo, limit)
            if ticks is None:
                return None
            longest = max(longest, -spool.length_change(ticks))
        return longest if longest > _SPRINGS_BACK else None

    @property
    def servos(self) -> tuple[Servo, ...]:
        """All servos: cables, then fins."""
        return self.cables + self.fins

    @property
    def fastest_cable(self) -> float:
        """Speed of the cable that every cable servo can play, m/s."""
        return min(
            spool.speed(servo.velocity_limit)
            for spool, servo in zip(self.settings.spools, self.cables, strict=True)
        )

    # --- torque off ----------------------------------------------------------------------------

    def home(self) -> None:
        """Takes the cable's present length as the initial one. Raises HomingError, BusError."""
        if self.left_on:
            raise HomingError(f"homing needs the torque off, and {self.left_on}")
        self.homed = False
        with self._bus.patient():
            servos.home(self._bus, self.cables)
        self.homed = True

    def reboot(self) -> tuple[int, ...]:
        """Restarts the servos that report a hardware error; returns their ids. Raises DriverError."""
        register = COMMON["hardware_error_status"]
        with self._bus.patient():
            failed = tuple(s for s in self.servos if self._bus.read(s.number, register))
        for servo in failed:
            self._bus.reboot(servo.number)
            self.homed = self.homed and servo not in self.cables
        return tuple(servo.number for servo in failed)

    def check(self) -> None:
        """Raises HomingError, BusError or ConfigurationError where a servo is not fit to have its torque."""
        with self._bus.patient():
            self.homed = all(servos.is_homed(self._bus, servo) for servo in self.cables)
            if not self.homed:
                raise HomingError(
                    "the turn count of the cable servo is not known (first start, reboot or power cut): bring "
                    "the robot to its initial length by hand, then call the service home"
                )
            for servo in self.servos:
                servos.check(self._bus, servo)

    # --- torque --------------------------------------------------------------------------------

    def enable(self) -> float:
        """Gives every servo its torque where it stands, with its bus watchdog armed. Raises DriverError.

        Returns where the cable is held then (ΔL, m): a body that springs back has moved on meanwhile.
        """
        settings = self.settings
        with self._bus.patient():
            for spool, servo in zip(settings.spools, self.cables, strict=True):
                limit = servos.own_limit(servo, settings.limits)
                speed = settings.max_cable_speed / spool.radius
                servos.limit_motion(self._bus, servo, speed, settings.watchdog, limit)
            for servo in self.fins:
                servos.limit_motion(self._bus, servo, settings.fin_speed, settings.watchdog)
            return self._mean_change([servos.enable(self._bus, servo) for servo in self.servos])

    def release(self) -> list[str]:
        """Takes the torque off, by all means; returns what failed on the way, in words.

        But for a robot that was never taken over and would spring back.
        """
        if self.left_on:
            return [self.left_on]
        self.unreleased = servos.release_all(self._bus, self.servos)
        return self.unreleased

    def send(self, length_change: float, direction: int) -> None:
        """Sends the goals: ΔL in m, and the fins' direction, 0 for none. Raises BusError.

        Without a home a length means nothing: cable servos are left at the ticks of the last `hold`.
        """
        goals = self._hold_ticks
        if self.homed:
            goals = {s.servo: s.ticks(length_change) for s in self.settings.spools}
        if direction:
            goals = goals | {fin.servo: fin.ticks(direction) for fin in self.settings.fins}
        self._bus.sync_write(COMMON["goal_position"], goals)

    def hold(self, states: tuple[ServoState, ...]) -> None:
        """Keeps in mind where the cable servos are, for a cable whose home is lost."""
        self._hold_ticks = {
            servo.number: state.ticks
            for servo, state in zip(self.cables, states, strict=False)
            if state is not SILENT
        }

    # --- what states mean ----------------------------------------------------------------------

    def length_change(self, states: tuple[ServoState, ...]) -> float:
        """Mean change of length by the encoders (m); NaN without every one of them, or without a home."""
        cables = states[: len(self.cables)]
        if not self.homed or any(state is SILENT for state in cables):
            return math.nan
        return self._mean_change([state.ticks for state in cables])

    def _mean_change(self, ticks: Sequence[int]) -> float:
        """Mean change of length (m) of cables whose servos stand at these ticks; those of the fins may follow."""
        changes = [s.length_change(at) for s, at in zip(self.settings.spools, ticks, strict=False)]
        return math.fsum(changes) / len(changes)

    def fins_set(self, states: tuple[ServoState, ...], direction: int) -> bool:
        """Whether every fin stands where a direction asks for it."""
        if direction == 0:
            return False
        return all(
            state is not SILENT
            and abs(state.ticks - fin.ticks(direction)) <= _FIN_TOLERANCE
            and abs(state.velocity) <= _FIN_STILL
            for fin, state in zip(self.settings.fins, states[len(self.cables) :], strict=True)
        )
