# SPDX-License-Identifier: Apache-2.0
"""The robot: servos, spools, fins and the gait player, put together. One thread at a time may use it; ROS is unknown.

``cycle`` is what runs at 100 Hz: step the player, send the goals, read the state, look for faults.
"""

import math
import os
import time
from collections.abc import Callable, Sequence

from worm_driver.control import supervision
from worm_driver.control.driver_settings import DriverSettings
from worm_driver.control.supervision import Counts, Health
from worm_driver.control.telemetry import SILENT, ServoState, Snapshot
from worm_driver.errors import BusError, ConfigurationError, HomingError, LimitError, NoReplyError
from worm_driver.gait import gait_player
from worm_driver.gait.gait_limits import Gait, GaitLimits
from worm_driver.gait.gait_player import Observation, Phase, PlayerState
from worm_driver.servos import servo_setup as servos
from worm_driver.servos.registers import COMMON, WATCHDOG_EXPIRED
from worm_driver.servos.servo_bus import ServoBus
from worm_driver.servos.servo_setup import Servo
from worm_driver.servos.state_reader import StateReader

#: ticks, how near a fin must come to where it was sent
_FIN_TOLERANCE = 40
#: rad/s, below which a fin stands still
_FIN_STILL = 0.1
#: readings of the state before an activation, of which one must succeed
_ATTEMPTS = 5
#: s, for which the loop's own lateness explains a bus watchdog that has expired: health is read in turn
_REMEMBERED = 0.5
#: m, closer to its initial length a robot that is let go does not spring back to speak of
_SPRINGS_BACK = 2e-3
#: m, slack beyond the initial length with which the robot may still be activated
_PAYOUT_TOLERANCE = 0.01


class Robot:
    """A robot whose servos have answered and are set up, with the torque off.

    A contracted robot that an earlier driver left with its torque on keeps it, as it would spring back: see left_on.

    Args:
        settings: of this robot.
        bus: an open bus, which the robot owns from now on.
        valid_power_samples: counts the valid power samples since the start.
        tracker_ready: whether the tracker sees the robot stand, or there is none to wait for.
        clock: s, monotonic.
        load: of the computer, as its load average.
        why_not_start: why neither torque nor a run may begin, in words; empty when they may.

    Attributes:
        unreleased: what failed at the last release, in words: a servo may still have its torque.
        left_on: what there is to say of a torque that an earlier driver left on; empty: there is none.

    Raises:
        BusError: a servo does not answer.
        ConfigurationError: a servo is not what the settings say.
    """

    def __init__(
        self,
        settings: DriverSettings,
        bus: ServoBus,
        valid_power_samples: Callable[[], int] = lambda: 0,
        tracker_ready: Callable[[], bool] = lambda: True,
        clock: Callable[[], float] = time.monotonic,
        load: Callable[[], float] = lambda: os.getloadavg()[0],
        why_not_start: Callable[[], str] = lambda: "",
    ):
        self.settings = settings
        self.bus = bus
        self.player = PlayerState()
        self.active = False
        self.unreleased: list[str] = []
        self.left_on = ""
        self._clock = clock
        self._load = load
        self._why_not_start = why_not_start
        self._tracker_ready = tracker_ready
        self._valid_power_samples = valid_power_samples
        self._idle_from = 0
        self._hold_ticks: dict[int, int] = {}
        self._counts = Counts()
        self._last_step = clock()
        self._last_look = -math.inf
        self._away, self._away_at = 0.0, -math.inf
        with bus.patient():
            self.cables = tuple(servos.identify(bus, spool.servo) for spool in settings.spools)
            self.fins = tuple(servos.identify(bus, fin.servo) for fin in settings.fins)
            self._set_up()
        self._reader = StateReader(bus, self.servos)
        self._states: tuple[ServoState, ...] = (SILENT,) * len(self.servos)

    def _set_up(self) -> None:
        for servo in self.servos:
            servos.check(self.bus, servo)
        for servo in self.fins:
            servos.prepare_fin(self.bus, servo)
        contraction = self._held_contraction()
        if contraction is not None:
            self.homed = True
            self.left_on = (
                f"the torque is on, as an earlier driver left it, with the robot contracted by "
                f"{contraction * 1e3:.1f} mm: it would spring back if it were let go; activate to take it over, "
                "then deactivate to bring it to rest"
            )
            self.player = PlayerState(message=self.left_on)
            return
        for servo in self.cables:
            servos.prepare_cable(self.bus, servo, servos.own_limit(servo, self.settings.limits))
        self.homed = all(servos.is_homed(self.bus, servo) for servo in self.cables)
        if self.settings.home_at_start and not self.homed:
            self.home()

    def _held_contraction(self) -> float | None:
        """By how much (m) servos that were left with their torque on hold the robot contracted; None if they do not."""
        longest = 0.0
        for spool, servo in zip(self.settings.spools, self.cables, strict=True):
            limit = servos.own_limit(servo, self.settings.limits)
            ticks = servos.held_position(self.bus, servo, limit)
            if ticks is None:
                return None
            longest = max(longest, -spool.length_change(ticks))
        return longest if longest > _SPRINGS_BACK else None

    @property
    def servos(self) -> tuple[Servo, ...]:
        """All servos: cables, then fins."""
        return self.cables + self.fins

    @property
    def limits(self) -> GaitLimits:
        """What may be asked of this robot: the settings, and what its servos can do."""
        speeds = [
            spool.speed(servo.velocity_limit)
            for spool, servo in zip(self.settings.spools, self.cables, strict=True)
        ]
        return GaitLimits(
            self.settings.max_stroke,
            self.settings.max_frequency,
            min(self.settings.max_cable_speed, *speeds),
        )

    # --- commands: each between two cycles -----------------------------------------------------

    def home(self) -> None:
        """Takes the cable's present length as the initial one. Raises HomingError, BusError."""
        if self.active:
            raise HomingError("homing needs the torque off: deactivate the driver first")
        if self.left_on:
            raise HomingError(f"homing needs the torque off, and {self.left_on}")
        self.homed = False
        with self.bus.patient():
            servos.home(self.bus, self.cables)
        self.homed = True

    def reboot(self) -> tuple[int, ...]:
        """Restarts the servos that report a hardware error; returns their ids. Raises DriverError."""
        if self.active:
            raise ConfigurationError("a reboot needs the torque off: deactivate the driver first")
        register = COMMON["hardware_error_status"]
        with self.bus.patient():
            failed = tuple(s for s in self.servos if self.bus.read(s.number, register))
        for servo in failed:
            self.bus.reboot(servo.number)
            self.homed = self.homed and servo not in self.cables
        return tuple(servo.number for servo in failed)

    def activate(self, now: float) -> None:
        """Enables the torque of every servo where it stands, with its bus watchdog armed.

        Raises:
            LimitError: nothing may start.
            HomingError: the length of the cable is not known.
            BusError, ConfigurationError: a servo is not fit; the torque is off again.
        """
        self._refuse_start()
        with self.bus.patient():
            self._check_fitness()
        self._reader.learn_clocks()
        cable = self._measured_cable()
        if not -self.settings.max_stroke - _PAYOUT_TOLERANCE <= cable <= _PAYOUT_TOLERANCE:
            raise HomingError(
                f"the cable is {cable * 1e3:.1f} mm from its initial length, out of its range: bring the "
                "robot to its initial length by hand, then call the service home"
            )
        try:
            with self.bus.patient():
                held = self._enable_all()
        except Exception:
            self.release()
            raise
        self._reader.forget_suspects()
        run = self.player.run
        self.player = PlayerState(since=now, length_change=held, run=run)
        self._counts, self._away_at, self.active = Counts(), -math.inf, True
        self._last_step = self._clock()
        self.unreleased, self.left_on = [], ""

    def _refuse_start(self) -> None:
        reason = self._why_not_start()
        if reason:
            raise LimitError(reason)

    def _check_fitness(self) -> None:
        self.homed = all(servos.is_homed(self.bus, servo) for servo in self.cables)
        if not self.homed:
            raise HomingError(
                "the turn count of the cable servo is not known (first start, reboot or power cut): bring "
                "the robot to its initial length by hand, then call the service home"
            )
        for servo in self.servos:
            servos.check(self.bus, servo)

    def _measured_cable(self) -> float:
        """Change of length of the cable, read now (m). Raises NoReplyError."""
        for _ in range(_ATTEMPTS):
            cable = self._cable_length_change(self._reader.read()[1])
            if not math.isnan(cable):
                return cable
        seen = "; ".join(f"servo {servo} {why}" for servo, why in self._reader.problems.items())
        raise NoReplyError(f"no length of the cable: {seen or 'its servo gives no position'}")

    def start(self, now: float, gait: Gait, cycles: int) -> int:
        """Begins a run and returns its number. Raises LimitError."""
        if not self.active:
            raise LimitError("the torque is off: activate the driver first")
        self._refuse_start()
        self.limits.check(gait, cycles)
        self.player = gait_player.start(self.player, now, gait, cycles)
        assert self.player.run is not None
        return self.player.run.number

    def take(self, now: float, settings: DriverSettings) -> str:
        """Goes on with other limits. A run that they do not allow ends at its next point of rest; says so."""
        self.settings = settings
        run = self.player.active_run
        if run is None:
            return ""
        try:
            self.limits.check(run.gait, run.cycles)
        except LimitError as error:
            self.cancel(now, f"ended by a new limit ({error})")
            return f"run {run.number} ends at its next point of rest: {error}"
        return ""

    def finish(self, now: float) -> None:
        """Lets the run end as completed with the present cycle."""
        self.player = gait_player.finish(self.player, now)

    def cancel(self, now: float, reason: str = "cancelled") -> None:
        """Lets the run end at its next point of rest."""
        self.player = gait_player.cancel(self.player, now, reason)

    def stop(self, now: float, reason: str) -> None:
        """Holds the cable where it is, at once."""
        if self.active:
            self.player = gait_player.stop(self.player, now, self._here(), reason)
            self._send_goals()

    def fail(self, now: float, reason: str) -> None:
        """Holds the cable where it is, until the next activation."""
        self.player = gait_player.fault(self.player, now, self._here(), reason)

    def begin_release(self, now: float, reason: str) -> None:
        """Brings the gait to rest; ``released`` tells when the torque may go.

        After a fault there is no way back to rest that could be trusted: the torque goes at once.
        """
        if self.active and self.player.phase is not Phase.FAULT:
            self.player = gait_player.return_to_rest(self.player, now, reason)

    @property
    def released(self) -> bool:
        """Whether nothing moves any more that the torque should hold."""
        return (
            not self.active or self.player.phase is Phase.FAULT or gait_player.at_rest(self.player)
        )

    @property
    def holding(self) -> bool:
        """Whether a stop holds the cable where it is, with the torque on."""
        return self.active and self.player.phase is Phase.HOLDING

    def release(self) -> list[str]:
        """Takes the torque off, by all means; returns what failed on the way, in words.

        But for a robot that was never taken over and would spring back.
        """
        self.active = False
        if self.left_on:
            return [self.left_on]
        self.unreleased = servos.release_all(self.bus, self.servos)
        return self.unreleased

    # --- the cycle -----------------------------------------------------------------------------

    def cycle(self, now: float) -> Snapshot:
        """Plays one step and reads the robot. Never raises for what a servo or the port does.

        Args:
            now: s, monotonic, of the cycle's start.
        """
        self._step(now)
        read_time = now
        try:
            if self.active:
                self._send_goals()
            before = self._states
            read_time, self._states = self._reader.read()
            self._supervise(now, before)
        except BusError as error:
            self._states = (SILENT,) * len(self.servos)
            if self.active:
                self.fail(now, str(error))
        return Snapshot(
            command_time=now,
            read_time=read_time,
            active=self.active,
            player=self.player,
            commanded=self.player.length_change if self.active else math.nan,
            cable=self._cable_length_change(self._states),
            servos=self._states,
            alerts=self._reader.alerts,
            homed=self.homed,
        )

    def _step(self, now: float) -> None:
        gap = now - self._last_step
        self._last_step = max(now, self._last_step)
        if not self.active:
            return
        if gap > self.settings.watchdog / 2:
            self._away, self._away_at = gap, now
        if gap > self.settings.watchdog and gait_player.moving(self.player):
            self.fail(now, self._lateness())
        before = self.player.phase
        samples = self._valid_power_samples()
        idle_samples = samples - self._idle_from
        seen = Observation(self._fins_set(), idle_samples, self._tracker_ready())
        settings = self.settings.player
        self.player = gait_player.step(self.player, now, seen, settings)
        if self.player.phase is Phase.RESTING and before is not Phase.RESTING:
            self._idle_from = samples

    def _lateness(self) -> str:
        return supervision.lateness(self._away, self.settings.watchdog, self._load())

    def _send_goals(self) -> None:
        goals = self._cable_goals()
        if self.player.direction:
            goals |= {f.servo: f.ticks(self.player.direction) for f in self.settings.fins}
        self.bus.sync_write(COMMON["goal_position"], goals)

    def _cable_goals(self) -> dict[int, int]:
        """Where each cable servo is to be, ticks.

        Without a home a length means nothing: servos are left at the ticks where they were last seen.
        """
        if self.homed:
            return {s.servo: s.ticks(self.player.length_change) for s in self.settings.spools}
        return self._hold_ticks

    def _supervise(self, now: float, before: tuple[ServoState, ...]) -> None:
        silent = (
            servo.number
            for servo, state in zip(self.servos, self._states, strict=True)
            if state is SILENT
        )
        ended = self._clock()
        watched = supervision.watched_time(ended - self._last_look, self.settings.period)
        self._counts = supervision.silence(self._counts, silent, watched)
        self._last_look = ended
        if not self.active or self.player.phase is Phase.FAULT:
            return
        reason = (
            self._fault_of_suspect()
            or self._fold(before)
            or supervision.fault_in_counts(
                self._count_deviations(),
                self.settings.limits,
                self._reader.problems,
                supervision.crowding(self._load(), os.cpu_count() or 1),
            )
        )
        if reason is not None:
            self.fail(now, reason)
            self._hold_ticks = {
                servo.number: state.ticks
                for servo, state in zip(self.cables, self._states, strict=False)
                if state is not SILENT
            }
            self._send_goals()

    def _count_deviations(self) -> Counts:
        limits = self.settings.limits
        efforts = {
            servo.number: state.effort
            for servo, state in zip(self.cables, self._states, strict=False)
            if state is not SILENT
        }
        levels = {servo.number: servos.fault_level(servo, limits) for servo in self.cables}
        counts = supervision.overload(self._counts, efforts, levels)
        error = self._cable_length_change(self._states) - self.player.length_change
        self._counts = supervision.following(counts, error, limits)
        return self._counts

    def _fault_of_suspect(self) -> str | None:
        """Looks again at a servo whose answers were odd, on a quiet line; at one per cycle, to keep it short."""
        suspect = self._reader.take_suspect()
        servo = next((servo for servo in self.servos if servo.number == suspect), None)
        if servo is None:
            return None
        names = ("torque_enable", "led", "hardware_error_status", "bus_watchdog")
        found = self._reader.look(servo, names)
        if found is None:
            return None  # a servo that does not answer is counted as such
        health = Health(*(found[name] for name in names))
        is_cable = servo in self.cables
        self.homed = self.homed and not (is_cable and not health.led)
        if health.watchdog == WATCHDOG_EXPIRED and self._clock() - self._away_at < _REMEMBERED:
            return self._lateness()
        return supervision.fault_in_health(servo.number, health, is_cable=is_cable)

    def _fold(self, before: tuple[ServoState, ...]) -> str | None:
        for servo, old, new in zip(self.cables, before, self._states, strict=False):
            if old is SILENT or new is SILENT:
                continue
            elapsed = (new.tick - old.tick) % 32.768
            if supervision.turn_count_jumped(old.ticks, new.ticks, elapsed, servo.velocity_limit):
                self.homed = False
                return f"the turn count of servo {servo.number} jumped by {new.ticks - old.ticks} ticks"
        return None

    def _enable_all(self) -> float:
        """Returns where the cable is held then (m): a body that springs back has moved on meanwhile."""
        fastest = self.settings.max_cable_speed
        for spool, servo in zip(self.settings.spools, self.cables, strict=True):
            limit = servos.own_limit(servo, self.settings.limits)
            speed = fastest / spool.radius
            servos.limit_motion(self.bus, servo, speed, self.settings.watchdog, limit)
        for servo in self.fins:
            servos.limit_motion(self.bus, servo, self.settings.fin_speed, self.settings.watchdog)
        return self._mean_change([servos.enable(self.bus, servo) for servo in self.servos])

    def _here(self) -> float:
        """Where the cable is, or was asked to be when that is not known (m)."""
        cable = self._cable_length_change(self._states)
        return cable if math.isfinite(cable) else self.player.length_change

    def _cable_length_change(self, states: tuple[ServoState, ...]) -> float:
        """Mean change of length by the encoders (m); NaN without every one of them, or without a home."""
        cables = states[: len(self.cables)]
        if not self.homed or any(state is SILENT for state in cables):
            return math.nan
        return self._mean_change([state.ticks for state in cables])

    def _mean_change(self, ticks: Sequence[int]) -> float:
        """Mean change of length (m) of cables whose servos stand at these ticks; those of the fins may follow."""
        changes = [s.length_change(at) for s, at in zip(self.settings.spools, ticks, strict=False)]
        return math.fsum(changes) / len(changes)

    def _fins_set(self) -> bool:
        direction = self.player.direction
        if direction == 0:
            return False
        states = self._states[len(self.cables) :]
        return all(
            state is not SILENT
            and abs(state.ticks - fin.ticks(direction)) <= _FIN_TOLERANCE
            and abs(state.velocity) <= _FIN_STILL
            for fin, state in zip(self.settings.fins, states, strict=True)
        )
