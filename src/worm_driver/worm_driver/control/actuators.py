# SPDX-License-Identifier: Apache-2.0
"""Actuators of a robot: checks, setup and motion of the servos with their spools and fins."""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from worm_driver.control.driver_settings import DriverSettings
from worm_driver.driver_errors import ConfigurationError, HomingError
from worm_driver.servos import servo_setup as servos
from worm_driver.servos.goal_gate import Bound, GoalGate
from worm_driver.servos.position_track import PositionSample, PositionTrack
from worm_driver.servos.registers import COMMON
from worm_driver.servos.servo_bus import ServoBus
from worm_driver.servos.servo_setup import Servo
from worm_driver.servos.state_reader import SILENT, ServoState
from worm_driver.servos.transmission import Spool
from worm_msgs.driver_file import DriverFile

#: Ratio of the limit that a servo enforces itself to the effort above which it is overloaded (`fault_level`). The ratio
#: is above 1, because a servo never exceeds its own limit: with a ratio of 1, no overload could be detected.
_HEADROOM = 1.1
#: Largest distance of a fin from its goal at which the fin counts as set, ticks.
_FIN_TOLERANCE = 40
#: Speed below which a fin counts as still, rad/s.
_FIN_STILL = 0.1
#: Contraction below which a robot without torque does not noticeably spring back, m.
_SPRINGS_BACK = 2e-3
#: Smallest ratio of the effort of a blocked cable servo to its `fault_level`. Gaits need less.
_STRAIN = 0.85
#: Largest distance of a servo from the present point of its profile, ticks. A servo with the factory gain 800/128 is at
#: full output (885) at a distance of 142 ticks.
_FOLLOWS = 160
#: Largest distance from a moving servo to the point where it holds, ticks. A weak servo takes longer for a larger one.
_YIELD = 100
#: Distance by which the cable may be beyond either end of the stroke range in an activation or a hold, m.
PAYOUT_TOLERANCE = 0.01


class CableLength(NamedTuple):
    """Length changes of the cable of one servo, m: measured (NaN if unknown) and commanded."""

    measured: float
    commanded: float


def own_limit(servo: Servo, limits: DriverFile) -> float:
    """Return the largest effort that a cable servo itself permits, A; a load ratio if the servo measures no current."""
    if servo.model.measures_current:
        return min(_HEADROOM * limits.max_servo_current, servo.model.strongest_current)
    return min(_HEADROOM * limits.max_servo_load, 1.0)


def fault_level(servo: Servo, limits: DriverFile) -> float:
    """Return the effort above which a cable servo is overloaded, in the unit of `own_limit`.

    It is max_servo_current or max_servo_load, or less if the servo cannot exceed this limit by the factor _HEADROOM.
    """
    return own_limit(servo, limits) / _HEADROOM


def require_registers(bus: ServoBus, servo: Servo, settings: DriverSettings) -> None:
    """Check that the registers of a servo which the driver does not write permit the settings."""
    for spool in settings.spools:
        if spool.servo == servo.number:
            speed = settings.max_cable_speed / spool.radius
            servos.require_speed(servo, speed, "limits.max_cable_speed_m_per_s")
    for fin in settings.fins:
        if fin.servo == servo.number:
            servos.require_speed(servo, settings.fin_speed, "fin_servos.speed_rad_per_s")
            servos.require_fin(bus, servo, *sorted((fin.ticks(1), fin.ticks(-1))))


def held_contraction(
    bus: ServoBus, cables: Sequence[Servo], settings: DriverSettings
) -> float | None:
    """Return the contraction (m) that the cable servos hold, if an earlier driver left their torque on.

    Return None if no cable servo has torque, or if the robot would not spring back without it.

    Raises:
        ConfigurationError: The torque must stay on, but this driver cannot take the robot over: a cable servo with
            torque is not homed or has other settings than this driver writes, or a cable servo has no torque while
            another one has.
        BusError: A servo does not answer.
    """
    ticks = [servos.held_position(bus, servo) for servo in cables]
    held = [
        -spool.length_change(at)
        for spool, at in zip(settings.spools, ticks, strict=True)
        if at is not None
    ]
    if max(held, default=0.0) <= _SPRINGS_BACK:
        return None
    for servo, at in zip(cables, ticks, strict=True):
        if at is None:
            raise ConfigurationError(
                f"servo {servo.number} has no torque, while another cable servo holds the robot contracted by "
                f"{max(held) * 1e3:.1f} mm: secure the body and switch the supply of the servos off"
            )
        servos.require_cable_settings(bus, servo, own_limit(servo, settings))
    return max(held)


def left_on(contraction: float) -> str:
    """Return the message about a torque that an earlier driver left on, with the robot contracted (m)."""
    return (
        f"an earlier driver left the torque on, with the robot contracted by {contraction * 1e3:.1f} mm: the robot "
        "would spring back without torque; activate the driver, then deactivate it to bring the robot to rest"
    )


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
        sprung_back: message about the last release, if it made the robot spring back; otherwise empty.
        track: plausible positions of the servos.
    """

    def __init__(self, settings: DriverSettings, bus: ServoBus):
        self.settings = settings
        self.unreleased: list[str] = []
        self.left_on = ""
        self.sprung_back = ""
        self._bus = bus
        self._has_torque = False
        self._held: Mapping[int, int] = {}
        self._shares: Mapping[int, float] = {}  # see `_hold_at`
        self._longest_stroke = settings.max_stroke
        with bus.retrying():
            self.cables = tuple(servos.identify(bus, spool.servo) for spool in settings.spools)
            self.fins = tuple(servos.identify(bus, fin.servo) for fin in settings.fins)
            self.track = PositionTrack({s.number: s.velocity_limit for s in self.servos})
            self._goals = GoalGate(bus, self.track)
            self._set_up()

    def _set_up(self) -> None:
        for servo in self.servos:
            require_registers(self._bus, servo, self.settings)
        for servo in self.servos:
            servos.check(self._bus, servo)
        contraction = held_contraction(self._bus, self.cables, self.settings)
        for servo in self.fins:
            servos.prepare_fin(self._bus, servo)
        if contraction is not None:
            self.homed = True
            self.left_on = left_on(contraction)
            return
        for servo in self.cables:
            servos.prepare_cable(self._bus, servo, own_limit(servo, self.settings))
        self.homed = all(servos.is_homed(self._bus, servo) for servo in self.cables)
        if self.settings.home_at_start and not self.homed:
            self.home()

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
        """Define the present cable length as the initial length."""
        if self.left_on:
            raise HomingError(f"homing needs the torque off, and {self.left_on}")
        self.homed = False
        with self._bus.retrying():
            servos.home(self._bus, self.cables)
        self.homed = True

    def reboot(self) -> tuple[int, ...]:
        """Restart the servos that report a hardware error and return their ids.

        A restarted cable servo must be homed again.
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
        """Check that every servo is fit to be enabled."""
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

        Each servo holds its own position, which is read here, because the body may still be springing back. A loaded
        servo that an earlier driver left with its torque on is behind the point of its profile. It keeps this point.

        Returns:
            Length change of the cable that is farthest from rest, m.
        """
        settings = self.settings
        self._longest_stroke = settings.max_stroke
        self._bound_goals()
        self.sprung_back = ""
        name = "position_trajectory"
        with self._bus.retrying():
            points = {
                servo.number: servos.registers(self._bus, servo, name)[name]
                for servo in (self.cables if self.left_on else ())
            }
            for spool, servo in zip(settings.spools, self.cables, strict=True):
                limit = own_limit(servo, settings)
                speed = settings.max_cable_speed / spool.radius
                servos.reset_control(self._bus, servo, speed, limit)
            for servo in self.fins:
                servos.reset_control(self._bus, servo, settings.fin_speed)
            # Servos that have torque already must not wait for the others longer than their watchdog.
            for servo in self.servos:
                servos.arm_watchdog(self._bus, servo, settings.watchdog)
            positions = {servo.number: self._enable(servo, points) for servo in self.servos}
        self.track.begin(positions)
        return self._hold_at(self._last_goals())

    def _enable(self, servo: Servo, points: Mapping[int, int]) -> PositionSample:
        """Enable the torque of a servo where it is. ``points`` of profiles (ticks, by servo id) are kept if near."""
        position = PositionSample(servos.standing_position(self._bus, servo), self._bus.now())
        self.track.record_if_plausible(servo.number, position.ticks, position.time)
        point = points.get(servo.number, position.ticks)
        near = abs(point - position.ticks) <= _FOLLOWS
        self._goals.write(servo.number, point if near else position.ticks)
        self._has_torque = True
        servos.switch_on(self._bus, servo)
        return position

    def apply_settings(self, settings: DriverSettings) -> None:
        """Apply lower limits. The range of the goals does not shrink before the next activation."""
        self.settings = settings
        self._bound_goals()

    def _bound_goals(self) -> None:
        """Set the bounds of the goals.

        A cable goal must lie within the range of the stroke, extended by PAYOUT_TOLERANCE at both ends. Its distance
        from the last plausible position must be at most the limit of the following error, plus the distance that the
        cable can have moved since this position was received. A fin goal must lie within the limits of its servo.
        """
        bounds = {servo.number: Bound(*servo.position_range) for servo in self.fins}
        for spool in self.settings.spools:
            ends = (PAYOUT_TOLERANCE, -self._longest_stroke - PAYOUT_TOLERANCE)
            low, high = sorted(spool.ticks(end) for end in ends)
            lead, speed = self.settings.max_following_error, self.settings.max_cable_speed
            bounds[spool.servo] = Bound(low, high, abs(spool.ticks(lead)), abs(spool.ticks(speed)))
        self._goals.bounds = bounds

    def release(self) -> list[str]:
        """Release the torque of every servo and return the failures, one sentence each.

        After an error of one servo, the others are still released, unless the first packet, to all servos at once,
        cannot be sent. While `left_on` is not empty, no servo is released, because the robot would spring back.
        """
        if self.left_on:
            return [self.left_on]
        if self._has_torque and self.contracted:
            self.sprung_back = (
                f"the torque is switched off while {self.contraction_text}: the robot springs back"
            )
        self._has_torque = False
        self.unreleased = servos.release_all(self._bus, self.servos)
        self.track.end()
        return self.unreleased

    def leave_torque_on(self) -> list[str]:
        """Leave the torque on, because the contracted robot would spring back. Return the message about this."""
        self.left_on = (
            f"the torque stays on, as {self.contraction_text} and would spring back: start the driver, activate it, "
            "then deactivate it to bring the robot to rest; or secure the body and switch the supply off"
        )
        return [self.left_on]

    @property
    def contracted(self) -> Mapping[int, float]:
        """Contractions (m) of the cables that would spring back without torque, by servo id; empty at rest.

        A cable at rest is included if the goal of its servo is not at rest, because the servo may still move there.
        """
        return {
            spool.servo: at
            for spool in self.settings.spools
            if max(at := self._contraction(spool), self._commanded(spool)) > _SPRINGS_BACK
        }

    def _contraction(self, spool: Spool) -> float:
        """Return the contraction (m) at the last plausible position, infinite if there is none.

        A servo that was not measured recently may have moved on to its goal.
        """
        position = self.track.last(spool.servo)
        if position is None:
            return math.inf
        at = -spool.length_change(position.ticks)
        return at if self._is_recent(position) else max(at, self._commanded(spool))

    def _commanded(self, spool: Spool) -> float:
        """Return the contraction (m) at the last goal, 0 before the first one."""
        return -spool.length_change(self._goals.last_sent(spool.servo) or 0)

    def _is_recent(self, position: PositionSample | None) -> bool:
        """Return True if a position was received in one of the last two cycles, or within `limits.max_silence`."""
        longest = max(self.settings.max_silence, 2 * self.settings.period)
        return position is not None and self._bus.now() - position.time <= longest

    @property
    def contraction_text(self) -> str:
        """Clause with the measured contraction of each cable that would spring back."""
        each = [
            f"{length * 1e3:.1f} mm at servo {servo}" for servo, length in self.contracted.items()
        ]
        return f"the robot is contracted by {' and '.join(each) or 'at most 2 mm'}"

    def send(self, length_change: float, direction: int) -> None:
        """Send the goals of all servos in one packet.

        If the robot is no longer homed, a length has no meaning, and the cable servos keep the goals that `enable` or
        `hold` stored.

        Args:
            length_change: ΔL, m. After `enable` and `hold`, until it is 0: ΔL of the cable that is farthest from rest;
                the others keep their ratio to it.
            direction: direction of the fins, 1 or -1; 0: the fins keep the goals that `enable`, `hold` or `stop_fins`
                stored.
        """
        goals = dict(self._held)
        if not length_change:
            self._shares = {}
        if self.homed:
            goals |= {s.servo: s.ticks(self._goal(s, length_change)) for s in self.settings.spools}
        if direction:
            goals |= {fin.servo: fin.ticks(direction) for fin in self.settings.fins}
        self._goals.send(goals)

    def _goal(self, spool: Spool, length_change: float) -> float:
        return length_change * self._shares.get(spool.servo, 1.0)

    def hold(self, states: tuple[ServoState, ...]) -> float:
        """Hold each cable servo where it is (`_hold_point`), and the fins and cable servos not homed at their goals.

        Returns:
            Length change of the cable that is farthest from rest, m.
        """
        goals = self._last_goals()
        if self.homed:
            for servo, state in zip(self.cables, states, strict=False):
                goals[servo.number] = self._hold_point(servo, state, goals[servo.number])
        return self._hold_at(goals)

    def _hold_point(self, servo: Servo, state: ServoState, goal: int) -> int:
        """Return the goal (ticks) with which a cable servo stays where it is.

        This is the present point of its profile, near which a load holds the shaft. So repeated holds do not move the
        cable. Exceptions:

        - A servo that works nearly at its limit, as with a blocked cable, holds its measured position.
        - If the state is missing or old, or the position is too far from the profile and therefore probably wrong, the
          servo keeps its goal.
        - A servo far behind a profile that has not ended, as a weak one, holds a point nearer to its position.
        """
        if state is SILENT or not self._is_recent(self.track.last(servo.number)):
            return goal
        ahead = state.trajectory - state.ticks
        strongest = _STRAIN * fault_level(servo, self.settings)
        if ahead * state.effort > 0.0 and abs(state.effort) >= strongest:
            return state.ticks
        if abs(ahead) > _FOLLOWS or state.trajectory == goal:
            return goal
        return state.ticks + max(-_YIELD, min(ahead, _YIELD))

    def _last_goals(self) -> dict[int, int]:
        goals = ((servo.number, self._goals.last_sent(servo.number)) for servo in self.servos)
        return {number: goal for number, goal in goals if goal is not None}

    def _hold_at(self, goals: Mapping[int, int]) -> float:
        """Store goals (ticks by servo id) that `send` repeats while it computes no others.

        Return the length change (m) of the cable that is farthest from rest. The shares of the others in it are stored,
        so that each servo returns to rest from its own goal, and all arrive at the same time.
        """
        self._held = goals
        changes = {s.servo: s.length_change(goals[s.servo]) for s in self.settings.spools}
        farthest = max(changes.values(), key=abs)
        self._shares = {n: change / farthest for n, change in changes.items()} if farthest else {}
        return farthest

    def stop_fins(self) -> None:
        """Replace the stored goals of the fins by their last plausible positions, which stops a flip."""
        positions = {servo.number: self.track.last(servo.number) for servo in self.fins}
        self._held = dict(self._held) | {
            n: at.ticks for n, at in positions.items() if at is not None
        }

    # --- evaluation of states ----------------------------------------------------------------------

    def cable_lengths(
        self, states: tuple[ServoState, ...], length_change: float = 0.0
    ) -> Mapping[int, CableLength]:
        """Return the length change of each cable, by servo id, with a commanded length change (m) as in `send`.

        The measured length is NaN before homing and for a silent servo.
        """
        return {
            spool.servo: CableLength(
                math.nan if state is SILENT or not self.homed else spool.length_change(state.ticks),
                self._goal(spool, length_change),
            )
            for spool, state in zip(self.settings.spools, states, strict=False)
        }

    def length_change(self, states: tuple[ServoState, ...]) -> float:
        """Return the mean length change of the cables according to the encoders, m.

        Return NaN before homing, and if a cable servo is silent.
        """
        lengths = [cable.measured for cable in self.cable_lengths(states).values()]
        return math.nan if any(map(math.isnan, lengths)) else math.fsum(lengths) / len(lengths)

    def unset_fins(self, states: tuple[ServoState, ...], direction: int) -> tuple[int, ...]:
        """Return the ids of the fin servos that do not stand still at their positions for a direction.

        For the direction 0, in which the fins have no positions yet, return all ids.
        """
        return tuple(
            fin.servo
            for fin, state in zip(self.settings.fins, states[len(self.cables) :], strict=True)
            if direction == 0
            or state is SILENT
            or abs(state.ticks - fin.ticks(direction)) > _FIN_TOLERANCE
            or abs(state.velocity) > _FIN_STILL
        )
