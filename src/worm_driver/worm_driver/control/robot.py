# SPDX-License-Identifier: Apache-2.0
"""Robot: the actuators, the fault watch and the gait player together. Free of ROS, for one thread at a time.

`Robot.cycle` steps the player, sends the goals, reads the states of the servos and looks for faults. It runs at the
rate of the settings, 100 Hz by default.
"""

import math
import os
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import combinations

from worm_driver.control.actuators import PAYOUT_TOLERANCE, Actuators
from worm_driver.control.driver_settings import DriverSettings
from worm_driver.control.fault_watch import FaultWatch
from worm_driver.driver_errors import (
    BusError,
    ConfigurationError,
    HomingError,
    NoReplyError,
    RejectedError,
    StoppedError,
)
from worm_driver.gait import gait_player
from worm_driver.gait.gait_limits import GaitLimits
from worm_driver.gait.gait_player import Observation, Phase, PlayerState
from worm_driver.servos.servo_bus import ServoBus
from worm_driver.servos.state_reader import SILENT, ServoState, StateReader
from worm_msgs.gait import Gait


@dataclass(frozen=True)
class CycleSnapshot:
    """Result of one cycle. Times are monotonic, in s.

    Attributes:
        command_time: start of the cycle. If active, the goals are sent immediately after it.
        read_time: time at which the states of the servos were requested; command_time if the request failed.
        active: True if this driver has enabled the torque. A torque that an earlier driver left on does not count.
        homed: True if the length of the cable is known.
        player: state of the gait player.
        commanded: commanded length change of the cable, m; NaN if not active.
        cable: length change according to the encoders, m; NaN if a cable servo is silent, and before homing.
        servos: states in the order of the robot's servos; SILENT for a servo without a usable answer.
        alerts: ids of the servos whose last answer reported a hardware error.
    """

    command_time: float
    read_time: float
    active: bool
    player: PlayerState
    commanded: float
    cable: float
    servos: tuple[ServoState, ...]
    alerts: frozenset[int] = frozenset()
    homed: bool = False


#: Largest number of readings of the state before an activation. Two consecutive ones must agree.
_ATTEMPTS = 5
#: Phases in which nothing moves until a new command arrives.
_HOLDS = (Phase.HOLDING, Phase.FAULT)
#: Longest time for which the robot may still move after a stop, s.
_STANDS = 0.5
#: Largest difference between two agreeing readings of the cable length, m. It is not 0, because the body may be
#: springing back.
_AGREE = 3e-3
#: Largest difference between the lengths of two cables in an activation, m.
_SPREAD = 5e-3


class Robot:
    """Robot whose servos have answered and are set up.

    The torque is off until `activate` is called, unless an earlier driver left it on (`Actuators.left_on`).

    Args:
        settings: settings of the robot at the start.
        bus: open servo bus, owned by the robot from now on.
        valid_power_samples: returns the number of valid power samples since the start.
        tracker_ready: returns True if the tracker sees the robot at rest, or if there is no tracker.
        clock: returns the time, s, monotonic.
        load: returns the computer's load average.
        why_not_start: returns the reason why torque and runs must not start; empty if they may.

    Attributes:
        player: state of the gait player.
        active: True while the torque is on.
        closing: True while the driver shuts down. No run can then begin.
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
        self.closing = False
        self._why_not_start = why_not_start
        self._tracker_ready = tracker_ready
        self._valid_power_samples = valid_power_samples
        self._idle_from = 0
        self.actuators = Actuators(settings, bus)
        self.player = PlayerState(message=self.actuators.left_on)
        self._reader = StateReader(bus, self.actuators.servos, self.actuators.track)
        self._watch = FaultWatch(self.actuators, self._reader, clock, load)
        self._forget_states()
        self._releases_fault = False  # True: `ramp_to_rest` was last called in FAULT
        self._fins_set_for = 0  # the direction for which the fins have been set; 0: none

    def _forget_states(self) -> None:
        """Drop the states that were read before the servos were set up, because the robot may have moved since."""
        self._states: tuple[ServoState, ...] = (SILENT,) * len(self.actuators.servos)

    @property
    def settings(self) -> DriverSettings:
        """Present settings, see `apply_settings`."""
        return self.actuators.settings

    @property
    def problems(self) -> Mapping[int, str]:
        """Reasons why the state of a servo is missing, by servo id."""
        return self._reader.problems

    @property
    def limits(self) -> GaitLimits:
        """Limits of the gaits, from the settings and from the highest speed that the cable servos can reach."""
        settings = self.settings
        fastest = min(settings.max_cable_speed, self.actuators.fastest_cable)
        return GaitLimits(settings.max_stroke, settings.max_frequency, fastest)

    @property
    def return_speed(self) -> float:
        """Peak cable speed of a return to rest, m/s. The servos do not follow a faster one."""
        return min(self.settings.player.return_speed, self.limits.max_cable_speed)

    # --- commands: each between two calls of `cycle` -------------------------------------------

    def home(self) -> None:
        """Define the present cable length as the initial length."""
        if self.active:
            raise HomingError("homing needs the torque off: deactivate the driver first")
        self.actuators.home()

    def reboot(self) -> tuple[int, ...]:
        """Restart the servos that report a hardware error and return their ids."""
        if self.active:
            raise ConfigurationError("a reboot needs the torque off: deactivate the driver first")
        return self.actuators.reboot()

    def activate(self, now: float) -> None:
        """Enable the torque of every servo at its present position, with its bus watchdog armed.

        After an error the torque is off again, unless an earlier driver left it on (`Actuators.left_on`).

        Raises:
            RejectedError: The driver shuts down, an emergency stop or another driver forbids a start, or the position
                of a servo is out of the bounds of its goals.
            HomingError: The length of a cable is unknown or out of its range, or the lengths differ too much.
            BusError: A servo does not answer.
            ConfigurationError: A servo is not fit to be enabled.
        """
        self._check_start()
        self.actuators.check()
        self._reader.learn_clocks()
        self._check_lengths(self._measured_cables())
        try:
            held = self.actuators.enable()
        except Exception:
            self.release()
            raise
        self._reader.forget_suspects()
        run = self.player.run
        self.player = PlayerState(phase_start=now, length_change=held, run=run)
        self._watch.begin()
        self._forget_states()
        self.actuators.unreleased, self.actuators.left_on = [], ""
        self.active = True

    def _check_start(self) -> None:
        if self.closing:
            raise RejectedError("the driver shuts down: start it again first")
        reason = self._why_not_start()
        if reason:
            raise RejectedError(reason)

    def _check_lengths(self, lengths: Mapping[int, float]) -> None:
        """Raise HomingError if a length change (m, by servo id) is out of range, or if two of them differ too much.

        The cables of a robot that an earlier driver left contracted may differ, for example after a fault of one servo.
        """
        remedy = "bring the robot to its initial length manually, then call the service home"
        for servo, cable in lengths.items():
            if not -self.settings.max_stroke - PAYOUT_TOLERANCE <= cable <= PAYOUT_TOLERANCE:
                raise HomingError(
                    f"the cable of servo {servo} is {cable * 1e3:.1f} mm from its initial length, out of its range: "
                    f"{remedy}"
                )
        for (one, first), (other, second) in combinations(lengths.items(), 2):
            if abs(first - second) > _SPREAD and not self.actuators.left_on:
                raise HomingError(
                    f"the cables differ: servo {one} is at {first * 1e3:.1f} mm and servo {other} at "
                    f"{second * 1e3:.1f} mm, more than {_SPREAD * 1e3:g} mm apart: {remedy}"
                )

    def _measured_cables(self) -> Mapping[int, float]:
        """Return the length change of each cable (m, by servo id), read until two consecutive readings agree."""
        before: Mapping[int, float] = {}
        seen: dict[int, str] = {}
        for _ in range(_ATTEMPTS):
            cables = self.actuators.cable_lengths(self._reader.read()[1])
            seen |= self._reader.problems
            lengths = {servo: cable.measured for servo, cable in cables.items()}
            if all(
                abs(length - before.get(n, math.nan)) <= _AGREE for n, length in lengths.items()
            ):
                return lengths
            before = lengths
        problems = "; ".join(f"servo {servo} {why}" for servo, why in seen.items())
        raise NoReplyError(
            f"cannot measure the length of the cable: {problems or 'its servo reports another position each time'}"
        )

    def start(self, now: float, gait: Gait, cycles: int) -> int:
        """Begin a run and return its number."""
        if not self.active:
            raise RejectedError("the torque is off: activate the driver first")
        self._check_start()
        self.limits.check(gait, cycles)
        self.player = gait_player.start(self.player, now, gait, cycles)
        assert self.player.run is not None
        return self.player.run.number

    def apply_settings(self, now: float, settings: DriverSettings) -> str:
        """Apply new limits.

        A run that violates the new limits is cancelled, see `cancel`. In this case return a message, else an empty
        string.
        """
        self.actuators.apply_settings(settings)
        run = self.player.active_run
        if run is None:
            return ""
        try:
            self.limits.check(run.gait, run.cycles)
        except RejectedError as error:
            self.cancel(now, f"ended by a new limit ({error})")
            return f"run {run.number} ends at its next point of rest: {error}"
        return ""

    def finish(self, now: float) -> None:
        """End the run as completed after its present cycle. Has no effect before the first cycle and without a run."""
        self.player = gait_player.finish(self.player, now)

    def cancel(self, now: float, reason: str = "cancelled") -> None:
        """End the run at its next point of rest.

        A run whose first cycle has not begun ends at once, unless the cable is returning to rest.
        """
        self.player = gait_player.cancel(self.player, now, reason)

    def stop(self, now: float, reason: str) -> str:
        """Hold the cable and the fins at their present positions immediately. Has no effect with the torque off.

        Returns:
            Message that says whether the robot holds.
        """
        if self.active:
            self._adopt(gait_player.stop(self.player, now, reason))
            self._send_goals()
            if self.player.phase is Phase.FAULT:
                return f"in FAULT, holding as far as the servos have torque: {self.player.message}"
            return "stopped, and holding"
        problems = self.actuators.unreleased or [self.actuators.left_on]
        return f"nothing to stop: {'; '.join(filter(None, problems)) or 'the torque is off'}"

    def fail(self, now: float, reason: str) -> None:
        """Hold the cable and the fins at their present positions until the next activation."""
        self._adopt(gait_player.fault(self.player, now, reason))

    def _adopt(self, player: PlayerState) -> None:
        """Store a new state of the player.

        When a hold begins, every servo is held (`Actuators.hold`). If not all fins are set then, every fin is stopped
        where it is.
        """
        if player.phase in _HOLDS and self.player.phase is not player.phase:
            player = replace(player, length_change=self.actuators.hold(self._states))
            if self.player.direction not in (0, self._fins_set_for):
                self.actuators.stop_fins()
        self.player = player

    def ramp_to_rest(self, now: float, reason: str) -> None:
        """Begin the return to rest. `released` is True once the torque may be switched off.

        In two cases no return begins:

        - In FAULT, the robot cannot be relied on to return. The torque may be switched off immediately, also during an
          emergency stop.
        - In HOLDING, while an emergency stop or another driver forbids motion, the robot stays where it is. The torque
          may be switched off only if the robot would not spring back.
        """
        blocked = self._why_not_start() if self.player.phase is Phase.HOLDING else ""
        if self.active and blocked and self.actuators.contracted:
            raise StoppedError(f"{self.actuators.contraction_text}, and may not move: {blocked}")
        self._releases_fault = self.player.phase is Phase.FAULT
        if self.active and not blocked and not self._releases_fault:
            self.player = gait_player.return_to_rest(self.player, now, reason)

    @property
    def _rests(self) -> bool:
        """True if the robot is commanded to rest, and is there according to the encoders."""
        return gait_player.at_rest(self.player) and not self.actuators.contracted

    @property
    def released(self) -> bool:
        """True if the torque may be switched off.

        This is the case if the torque is off already, if the robot is at rest, or if it holds and would not spring
        back. A holding robot that would spring back may be released only if `ramp_to_rest` was called in FAULT.
        """
        if not self.active or self._rests:
            return True
        permitted = self._releases_fault and self.player.phase is Phase.FAULT
        return self.holding and (permitted or not self.actuators.contracted)

    @property
    def holding(self) -> bool:
        """True if the torque is on and the robot holds its position after a stop or a fault."""
        return self.active and self.player.phase in _HOLDS

    def close(self, now: float, reason: str) -> None:
        """Begin to shut down. Return to rest, or hold if no motion may start, for example in an emergency stop."""
        why_not = self._why_not_start()
        if why_not and not self._rests:
            self.stop(now, why_not)
        else:
            self.ramp_to_rest(now, reason)

    def is_closed(self, now: float) -> bool:
        """Return True if the driver may end at a time (s).

        It may end if the torque is off, if the robot is at rest, or 0.5 s after the robot began to hold.
        """
        stands = self.player.phase in _HOLDS and now - self.player.phase_start >= _STANDS
        return not self.active or self._rests or stands

    def shutdown(self) -> list[str]:
        """Release the robot at the end of the driver, unless it would spring back. Return the failures.

        Only `release`, at an operator's request, makes a contracted robot spring back.
        """
        if self.active and self.actuators.contracted:
            self.active = False
            return self.actuators.leave_torque_on()
        return self.release()

    def release(self) -> list[str]:
        """Release the torque and return the failures, one sentence each. See `Actuators.release`."""
        self.active = False
        return self.actuators.release()

    # --- the control cycle ---------------------------------------------------------------------

    def cycle(self, now: float) -> CycleSnapshot:
        """Execute one control cycle, at the time ``now`` (s), and return its result.

        Never raises an error of a servo or of the port.
        """
        self._step(now)
        read_time = now
        try:
            if self.active:
                self._send_goals()
            read_time, self._states = self._reader.read()
            self._supervise(now)
        except BusError as error:
            self._states = (SILENT,) * len(self.actuators.servos)
            if self.active:
                self.fail(now, str(error))
        return CycleSnapshot(
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
        before = self.player
        samples = self._valid_power_samples()
        unset = self.actuators.unset_fins(self._states, before.direction)
        if before.direction and not unset:
            self._fins_set_for = before.direction
        observation = Observation(
            unset,
            samples - self._idle_from,
            self._tracker_ready(),
            at_rest=not self.actuators.contracted,
        )
        settings = replace(self.settings.player, return_speed=self.return_speed)
        self._adopt(gait_player.step(self.player, now, observation, settings))
        if self.player.phase is Phase.RESTING and before.phase is not Phase.RESTING:
            self._idle_from = samples
        if self.player.direction not in (0, before.direction):
            self._fins_set_for = 0

    def _send_goals(self) -> None:
        self.actuators.send(self.player.length_change, self.player.direction)

    def _supervise(self, now: float) -> None:
        self._watch.note_silence(self._states)
        if not self.active:
            return
        if self.player.phase is Phase.FAULT:
            self._watch.fault_of_servo()  # a servo that restarted is no longer homed
            return
        reason = self._watch.fault(self._states, self.player)
        if reason is not None:
            self.fail(now, reason)
            self._send_goals()
