# SPDX-License-Identifier: Apache-2.0
"""The robot: actuators, watch and gait player, put together. One thread at a time may use it; ROS is unknown.

``cycle`` is what runs at 100 Hz: step the player, send the goals, read the state, look for faults.
"""

import math
import os
import time
from collections.abc import Callable

from worm_driver.control.actuators import Actuators
from worm_driver.control.driver_settings import DriverSettings
from worm_driver.control.fault_watch import FaultWatch
from worm_driver.control.telemetry import SILENT, ServoState, Snapshot
from worm_driver.errors import BusError, ConfigurationError, HomingError, LimitError, NoReplyError
from worm_driver.gait import gait_player
from worm_driver.gait.gait_limits import Gait, GaitLimits
from worm_driver.gait.gait_player import Observation, Phase, PlayerState
from worm_driver.servos.servo_bus import ServoBus
from worm_driver.servos.state_reader import StateReader

#: readings of the state before an activation, of which one must succeed
_ATTEMPTS = 5
#: m, slack beyond the initial length with which the robot may still be activated
_PAYOUT_TOLERANCE = 0.01


class Robot:
    """A robot whose servos have answered and are set up, with the torque off.

    Args:
        bus: open; the robot owns it from now on.
        valid_power_samples: counts the valid power samples since the start.
        tracker_ready: whether the tracker sees the robot stand, or there is none to wait for.
        clock: s, monotonic.
        why_not_start: why neither torque nor a run may begin, in words; empty when they may.

    Attributes:
        player: what is played.
        active: whether the torque is on.

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
        self.bus = bus
        self.active = False
        self._why_not_start = why_not_start
        self._tracker_ready = tracker_ready
        self._valid_power_samples = valid_power_samples
        self._idle_from = 0
        self.actuators = Actuators(settings, bus)
        self.player = PlayerState(message=self.actuators.left_on)
        self._reader = StateReader(bus, self.actuators.servos)
        self._watch = FaultWatch(self.actuators, self._reader, clock, load)
        self._states: tuple[ServoState, ...] = (SILENT,) * len(self.actuators.servos)

    @property
    def settings(self) -> DriverSettings:
        """Those that it goes by now, see `take`."""
        return self.actuators.settings

    @property
    def limits(self) -> GaitLimits:
        """What may be asked of this robot: the settings, and what its servos can do."""
        settings = self.settings
        fastest = min(settings.max_cable_speed, self.actuators.fastest_cable)
        return GaitLimits(settings.max_stroke, settings.max_frequency, fastest)

    # --- commands: each between two cycles -----------------------------------------------------

    def home(self) -> None:
        """Takes the cable's present length as the initial one. Raises HomingError, BusError."""
        if self.active:
            raise HomingError("homing needs the torque off: deactivate the driver first")
        self.actuators.home()

    def reboot(self) -> tuple[int, ...]:
        """Restarts the servos that report a hardware error; returns their ids. Raises DriverError."""
        if self.active:
            raise ConfigurationError("a reboot needs the torque off: deactivate the driver first")
        return self.actuators.reboot()

    def activate(self, now: float) -> None:
        """Enables the torque of every servo where it stands, with its bus watchdog armed.

        Raises LimitError while nothing may start, HomingError where the length of the cable is not known, BusError or
        ConfigurationError where a servo is not fit: the torque is off again then.
        """
        self._refuse_start()
        self.actuators.check()
        self._reader.learn_clocks()
        cable = self._measured_cable()
        if not -self.settings.max_stroke - _PAYOUT_TOLERANCE <= cable <= _PAYOUT_TOLERANCE:
            raise HomingError(
                f"the cable is {cable * 1e3:.1f} mm from its initial length, out of its range: bring the "
                "robot to its initial length by hand, then call the service home"
            )
        try:
            held = self.actuators.enable()
        except Exception:
            self.release()
            raise
        self._reader.forget_suspects()
        run = self.player.run
        self.player = PlayerState(since=now, length_change=held, run=run)
        self._watch.begin()
        self.actuators.unreleased, self.actuators.left_on = [], ""
        self.active = True

    def _refuse_start(self) -> None:
        reason = self._why_not_start()
        if reason:
            raise LimitError(reason)

    def _measured_cable(self) -> float:
        """Change of length of the cable, read now (m). Raises NoReplyError."""
        for _ in range(_ATTEMPTS):
            cable = self.actuators.length_change(self._reader.read()[1])
            if not math.isnan(cable):
                return cable
        problems = "; ".join(f"servo {servo} {why}" for servo, why in self._reader.problems.items())
        raise NoReplyError(f"no length of the cable: {problems or 'its servo gives no position'}")

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
        self.actuators.settings = settings
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

        See `Actuators.release`.
        """
        self.active = False
        return self.actuators.release()

    # --- the cycle -----------------------------------------------------------------------------

    def cycle(self, now: float) -> Snapshot:
        """Plays one step and reads the robot, from a time (s) on. Never raises for what a servo or the port does."""
        self._step(now)
        read_time = now
        try:
            if self.active:
                self._send_goals()
            before = self._states
            read_time, self._states = self._reader.read()
            self._supervise(now, before)
        except BusError as error:
            self._states = (SILENT,) * len(self.actuators.servos)
            if self.active:
                self.fail(now, str(error))
        return Snapshot(
            command_time=now,
            read_time=read_time,
            active=self.active,
            player=self.player,
            commanded=self.player.length_change if self.active else math.nan,
            cable=self.actuators.length_change(self._states),
            servos=self._states,
            alerts=self._reader.alerts,
            homed=self.actuators.homed,
        )

    def _step(self, now: float) -> None:
        late = self._watch.step(now)
        if not self.active:
            return
        if late and gait_player.moving(self.player):
            self.fail(now, late)
        before = self.player.phase
        samples = self._valid_power_samples()
        fins_set = self.actuators.fins_set(self._states, self.player.direction)
        observation = Observation(fins_set, samples - self._idle_from, self._tracker_ready())
        self.player = gait_player.step(self.player, now, observation, self.settings.player)
        if self.player.phase is Phase.RESTING and before is not Phase.RESTING:
            self._idle_from = samples

    def _send_goals(self) -> None:
        self.actuators.send(self.player.length_change, self.player.direction)

    def _supervise(self, now: float, before: tuple[ServoState, ...]) -> None:
        self._watch.look(self._states)
        if not self.active or self.player.phase is Phase.FAULT:
            return
        reason = self._watch.fault(before, self._states, self.player.length_change)
        if reason is not None:
            self.fail(now, reason)
            self.actuators.hold(self._states)
            self._send_goals()

    def _here(self) -> float:
        """Where the cable is, or was asked to be when that is not known (m)."""
        cable = self.actuators.length_change(self._states)
        return cable if math.isfinite(cable) else self.player.length_change
