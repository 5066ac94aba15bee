# SPDX-License-Identifier: Apache-2.0
"""Actuators of a robot: checks, setup and motion of the servos with their spools and fins."""

import math
from collections.abc import Sequence

from worm_driver.control.driver_settings import DriverSettings
from worm_driver.control.supervision import fault_level, own_limit
from worm_driver.errors import ConfigurationError, HomingError
from worm_driver.servos import servo_setup as servos
from worm_driver.servos.goal_gate import Bound, GoalGate
from worm_driver.servos.position_track import PositionSample, PositionTrack
from worm_driver.servos.registers import COMMON
from worm_driver.servos.servo_bus import ServoBus
from worm_driver.servos.servo_setup import Servo
from worm_driver.servos.servo_state import SILENT, ServoState

#: Largest distance of a fin from its goal at which the fin counts as set, ticks.
_FIN_TOLERANCE = 40
#: Speed below which a fin counts as still, rad/s.
_FIN_STILL = 0.1
#: Contraction below which a robot without torque does not noticeably spring back, m.
_SPRINGS_BACK = 2e-3
#: Smallest ratio of a cable servo's effort to its `fault_level` at which `strains` can return True. Gaits need less.
_STRAIN = 0.85
#: Distance by which the cable may be beyond either end of the stroke range in an activation or a hold, m.
PAYOUT_TOLERANCE = 0.01


class Actuators:
    """All servos of a robot, identified and set up, with the torque off.

    If an earlier driver left the torque of a contracted robot on, the cable servos keep their torque, because the robot
    would spring back. See `left_on`.

    Attributes:
        settings: settings of this robot. `apply_settings` replaces them.
        cables: servos of the spools, in the order of the settings.
        fins: servos of the fins, in the order of the settings.
        homed: True if the cable servos count their turns from the initial length.
        unreleased: failures of the last release, one sentence each. If not empty, a servo may still have torque.
        left_on: message about a torque that was left on; empty if there is none.
        track: plausible positions of the servos.

    Raises:
        BusError: A servo does not answer.
        ConfigurationError: A servo does not match the settings.
        HomingError: The settings require homing at the start, and homing failed.
    """

    def __init__(self, settings: DriverSettings, bus: ServoBus):
        self.settings = settings
        self.unreleased: list[str] = []
        self.left_on = ""
        self._bus = bus
        self._held: dict[int, int] = {}
        self._longest_stroke = settings.max_stroke
        with bus.retrying():
            self.cables = tuple(servos.identify(bus, spool.servo) for spool in settings.spools)
            self.fins = tuple(servos.identify(bus, fin.servo) for fin in settings.fins)
            self.track = PositionTrack({s.number: s.velocity_limit for s in self.servos})
            self._goals = GoalGate(bus, self.track)
            self._set_up()

    def _set_up(self) -> None:
        self._check_registers()
        for servo in self.servos:
            servos.check(self._bus, servo)
        contraction = self._held_contraction()
        for servo in self.fins:
            servos.prepare_fin(self._bus, servo)
        if contraction is not None:
            self.homed = True
            self.left_on = (
                f"an earlier driver left the torque on, with the robot contracted by {contraction * 1e3:.1f} mm: the "
                "robot would spring back without torque; activate the driver, then deactivate it to bring the robot "
                "to rest"
            )
            return
        for servo in self.cables:
            servos.prepare_cable(self._bus, servo, own_limit(servo, self.settings.limits))
        self.homed = all(servos.is_homed(self._bus, servo) for servo in self.cables)
        if self.settings.home_at_start and not self.homed:
            self.home()

    def _check_registers(self) -> None:
        """Check that registers which the driver does not write permit the settings. Raises ConfigurationError."""
        settings = self.settings
        for spool, servo in zip(settings.spools, self.cables, strict=True):
            speed = settings.max_cable_speed / spool.radius
            servos.require_speed(servo, speed, "limits.max_cable_speed_m_per_s")
        for fin, servo in zip(settings.fins, self.fins, strict=True):
            servos.require_speed(servo, settings.fin_speed, "fin_servos.speed_rad_per_s")
            servos.require_fin(self._bus, servo, *sorted((fin.ticks(1), fin.ticks(-1))))

    def _held_contraction(self) -> float | None:
        """Return the contraction (m) that the cable servos hold, if an earlier driver left their torque on.

        Return None if no cable servo has torque, or if the robot would not spring back without it.

        Raises:
            ConfigurationError: The torque must stay on, but this driver cannot take the robot over: a cable servo with
                torque is not homed or has other settings than this driver writes, or a cable servo has no torque while
                another one has.
            BusError: A servo does not answer.
        """
        ticks = [servos.held_position(self._bus, servo) for servo in self.cables]
        held = [
            -spool.length_change(at)
            for spool, at in zip(self.settings.spools, ticks, strict=True)
            if at is not None
        ]
        if max(held, default=0.0) <= _SPRINGS_BACK:
            return None
        for servo, at in zip(self.cables, ticks, strict=True):
            if at is None:
                raise ConfigurationError(
                    f"servo {servo.number} has no torque, while another cable servo holds the robot contracted by "
                    f"{max(held) * 1e3:.1f} mm: secure the body and switch the supply of the servos off"
                )
            servos.require_cable_settings(self._bus, servo, own_limit(servo, self.settings.limits))
        return max(held)

    @property
    def servos(self) -> tuple[Servo, ...]:
        """All servos: cables, then fins."""
        return self.cables + self.fins

    @property
    def fastest_cable(self) -> float:
        """Highest cable speed that every cable servo can reach, m/s."""
        return min(
            spool.speed(servo.velocity_limit)
            for spool, servo in zip(self.settings.spools, self.cables, strict=True)
        )

    # --- torque off ----------------------------------------------------------------------------

    def home(self) -> None:
        """Define the present cable length as the initial length.

        Raises:
            HomingError: A torque was left on, a servo is too far from its encoder's zero, or it did not accept its new
                zero.
            BusError: A servo does not answer.
        """
        if self.left_on:
            raise HomingError(f"homing needs the torque off, and {self.left_on}")
        self.homed = False
        with self._bus.retrying():
            servos.home(self._bus, self.cables)
        self.homed = True

    def reboot(self) -> tuple[int, ...]:
        """Restart the servos that report a hardware error and return their ids.

        A restarted cable servo must be homed again.

        Raises:
            DriverError: An exchange failed.
        """
        register = COMMON["hardware_error_status"]
        with self._bus.retrying():
            failed = tuple(s for s in self.servos if self._bus.read(s.number, register))
        for servo in failed:
            self._bus.reboot(servo.number)
            self.homed = self.homed and servo not in self.cables
        if all(servo in failed for servo in self.cables):
            self.left_on = ""  # the restarted servos have no torque
        return tuple(servo.number for servo in failed)

    def check(self) -> None:
        """Check that every servo is fit to be enabled.

        Raises:
            HomingError: The turn count of a cable servo is unknown.
            BusError: A servo does not answer.
            ConfigurationError: A servo reports a fault, or its supply is out of range.
        """
        with self._bus.retrying():
            self.homed = all(servos.is_homed(self._bus, servo) for servo in self.cables)
            if not self.homed:
                raise HomingError(
                    "the turn count of the cable servo is not known (first start, reboot or power cut): bring "
                    "the robot to its initial length manually, then call the service home"
                )
            for servo in self.servos:
                servos.check(self._bus, servo)

    # --- torque --------------------------------------------------------------------------------

    def enable(self) -> float:
        """Enable the torque of every servo at its present position, with its bus watchdog armed.

        Returns:
            Length change at which the servos hold the cable, m. It is read here, because the body may still be
            springing back.

        Raises:
            DriverError: A servo cannot be enabled.
        """
        settings = self.settings
        self._longest_stroke = settings.max_stroke
        self._bound_goals()
        with self._bus.retrying():
            for spool, servo in zip(settings.spools, self.cables, strict=True):
                limit = own_limit(servo, settings.limits)
                speed = settings.max_cable_speed / spool.radius
                servos.reset_control(self._bus, servo, speed, limit)
            for servo in self.fins:
                servos.reset_control(self._bus, servo, settings.fin_speed)
            # Servos that have torque already must not wait for the others longer than their watchdog.
            for servo in self.servos:
                servos.arm_watchdog(self._bus, servo, settings.watchdog)
            positions = {servo.number: self._enable(servo) for servo in self.servos}
        self.track.begin(positions)
        self._held = {number: position.ticks for number, position in positions.items()}
        return self._mean_change([position.ticks for position in positions.values()])

    def _enable(self, servo: Servo) -> PositionSample:
        position = PositionSample(servos.standing_position(self._bus, servo), self._bus.now())
        self.track.record_if_plausible(servo.number, position.ticks, position.time)
        self._goals.write(servo.number, position.ticks)
        servos.switch_on(self._bus, servo)
        return position

    def apply_settings(self, settings: DriverSettings) -> None:
        """Apply new limits. The range of the goals does not shrink before the next activation."""
        self.settings = settings
        self._longest_stroke = max(self._longest_stroke, settings.max_stroke)
        self._bound_goals()

    def _bound_goals(self) -> None:
        """Set the bounds of the goals.

        A cable goal must lie within the range of the stroke, extended by PAYOUT_TOLERANCE at both ends. Its distance
        from the last plausible position must be at most the limit of the following error, plus the distance that the
        cable can have moved since this position was received. A fin goal must lie within the limits of its servo.
        """
        limits = self.settings.limits
        bounds = {servo.number: Bound(*servo.position_range) for servo in self.fins}
        for spool in self.settings.spools:
            ends = (PAYOUT_TOLERANCE, -self._longest_stroke - PAYOUT_TOLERANCE)
            low, high = sorted(spool.ticks(end) for end in ends)
            lead, speed = limits.following_error, self.settings.max_cable_speed
            bounds[spool.servo] = Bound(low, high, abs(spool.ticks(lead)), abs(spool.ticks(speed)))
        self._goals.bounds = bounds

    def release(self) -> list[str]:
        """Release the torque of every servo and return the failures, one sentence each.

        After an error of one servo, the others are still released, unless the first packet, to all servos at once,
        cannot be sent. While `left_on` is not empty, no servo is released, because the robot would spring back.
        """
        if self.left_on:
            return [self.left_on]
        self.unreleased = servos.release_all(self._bus, self.servos)
        self.track.end()
        return self.unreleased

    def leave_torque_on(self) -> list[str]:
        """Leave the torque on, because the contracted robot would spring back. Return the message about this."""
        self.left_on = (
            f"the torque stays on, as the robot is contracted by {self.contraction * 1e3:.1f} mm and would spring "
            "back: start the driver, activate it, then deactivate it to bring the robot to rest; or "
            "secure the body and switch the supply off"
        )
        return [self.left_on]

    @property
    def contraction(self) -> float:
        """Contraction of the robot (m) at the last plausible positions; infinite if one is missing."""
        positions = [self.track.last(servo.number) for servo in self.cables]
        if any(position is None for position in positions):
            return math.inf
        return -self._mean_change([position.ticks for position in positions if position])

    @property
    def springs_back(self) -> bool:
        """True if the robot would spring back without torque."""
        return self.contraction > _SPRINGS_BACK

    def send(self, length_change: float, direction: int) -> None:
        """Send the goals of all servos in one packet.

        If the robot is no longer homed, a length has no meaning, and the cable servos keep the goals that `enable` or
        `hold` stored.

        Args:
            length_change: ΔL, m.
            direction: direction of the fins, 1 or -1; 0: the fins keep the goals that `enable`, `hold` or `stop_fins`
                stored.

        Raises:
            RejectedError: The length change is not finite, or is out of the range of a cable servo.
            BusError: The packet cannot be sent.
        """
        goals = dict(self._held)
        if self.homed:
            goals |= {s.servo: s.ticks(length_change) for s in self.settings.spools}
        if direction:
            goals |= {fin.servo: fin.ticks(direction) for fin in self.settings.fins}
        self._goals.send(goals)

    def hold(self) -> None:
        """Store the last goals of all servos. `send` repeats a stored goal if it computes no new goal for the servo."""
        for servo in self.servos:
            goal = self._goals.last_sent(servo.number)
            if goal is not None:
                self._held[servo.number] = goal

    def stop_fins(self) -> None:
        """Replace the stored goals of the fins by their last plausible positions, which stops a flip."""
        for servo in self.fins:
            position = self.track.last(servo.number)
            if position is not None:
                self._held[servo.number] = position.ticks

    # --- evaluation of states ----------------------------------------------------------------------

    def length_change(self, states: tuple[ServoState, ...]) -> float:
        """Return the mean length change of the cables according to the encoders, m.

        Return NaN before homing, and if a cable servo is silent.
        """
        cables = states[: len(self.cables)]
        if not self.homed or any(state is SILENT for state in cables):
            return math.nan
        return self._mean_change([state.ticks for state in cables])

    def _mean_change(self, ticks: Sequence[int]) -> float:
        """Return the mean length change (m) for positions of the cable servos (ticks). Further elements are ignored."""
        changes = [s.length_change(at) for s, at in zip(self.settings.spools, ticks, strict=False)]
        return math.fsum(changes) / len(changes)

    def strains(self, states: tuple[ServoState, ...], error: float) -> bool:
        """Return True if a cable servo works nearly at its limit to reduce an error of the length.

        Args:
            states: states of the servos.
            error: commanded minus measured length change, m. NaN yields False.
        """
        limits = self.settings.limits
        return any(
            -spool.sign * state.effort * error > 0.0
            and abs(state.effort) >= _STRAIN * fault_level(servo, limits)
            for spool, servo, state in zip(self.settings.spools, self.cables, states, strict=False)
        )

    def unset_fins(self, states: tuple[ServoState, ...], direction: int) -> tuple[int, ...]:
        """Return the ids of the fin servos that do not stand still at their positions for a direction (1 or -1)."""
        return tuple(
            fin.servo
            for fin, state in zip(self.settings.fins, states[len(self.cables) :], strict=True)
            if state is SILENT
            or abs(state.ticks - fin.ticks(direction)) > _FIN_TOLERANCE
            or abs(state.velocity) > _FIN_STILL
        )
