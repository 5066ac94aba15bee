# SPDX-License-Identifier: Apache-2.0
"""Threads that own the robot and the power sensor.

Other threads submit commands to the robot's thread, which executes them between two cycles. After each cycle, a
callback receives a `CycleSnapshot`. Before the robot's thread ends, it switches the torque off over the serial bus,
without ROS. If the robot would spring back, the thread leaves the torque on, unless an operator requests the release.
"""

import contextlib
import math
import threading
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, TimeoutError
from dataclasses import dataclass
from typing import Any, TypeVar

from worm_driver.clock import Clock, MachineClock
from worm_driver.control.real_time import (
    NOT_REQUESTED,
    VIRTUAL,
    request_scheduling,
    return_to_normal,
)
from worm_driver.control.robot import CycleSnapshot, Robot
from worm_driver.control.timing import DeadlineGrid, PeriodMeter, TimingReport
from worm_driver.driver_errors import DriverError, RejectedError
from worm_driver.power.ina219 import INA219, PowerSample, SampleStatus

T = TypeVar("T")


class PeriodicThread:
    """Thread that calls a step at every deadline of a grid, until `request_end` or until the step returns False.

    Args:
        name: name of the thread.
        period: period of the grid, s.
        clock: clock of the thread; None: the machine's.

    Attributes:
        failure: exception that ended the thread; None without one.
    """

    def __init__(self, name: str, period: float, clock: Clock | None = None):
        self._clock: Clock = MachineClock() if clock is None else clock
        self.failure: Exception | None = None
        self._ending = threading.Event()
        self._meter = PeriodMeter(period)
        self._report = self._meter.report()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        # True if the step took long on purpose. Then no deadline counts as missed.
        self._excused = False

    def _step(self, now: float) -> bool:
        """Do the work of one cycle at a time (s, monotonic). Return False to end the thread."""
        raise NotImplementedError

    def _at_start(self) -> None:
        """Prepare the thread. Called in the thread before its first step."""

    def _at_end(self) -> None:
        """Clean up. Called in the thread when it ends, also after an exception."""

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def request_end(self) -> None:
        """Request the end of the thread after its present step. Safe in a signal handler."""
        self._ending.set()

    def end(self, timeout: float) -> bool:
        """End the thread after its present step. Return True if it ended within the timeout (s)."""
        self.request_end()
        self._thread.join(timeout)
        return not self._thread.is_alive()

    @property
    def alive(self) -> bool:
        """True while the thread runs."""
        return self._thread.is_alive()

    def report(self) -> TimingReport:
        """Return the timing report, which the thread itself updates once a second."""
        return self._report

    def _run(self) -> None:
        try:
            self._at_start()
            self._cycles()
        except Exception as error:  # noqa: BLE001 (after any error: release the robot)
            self.failure = error
        finally:
            self._at_end()

    def _cycles(self) -> None:
        period = self._meter.period
        clock = self._clock
        grid = DeadlineGrid(clock(), period)
        due, going = grid.start, True
        while going and not self._ending.is_set():
            previous, due = due, grid.next_after(clock())
            if self._excused:
                self._excused, previous = False, due - period
                self._meter.pause()
            clock.sleep_until(due)
            now = clock()
            self._meter.begin(now, due, skipped=round((due - previous) / period) - 1)
            going = self._step(now)
            if not self._excused:
                self._meter.end(clock())
            if self._meter.cycles % round(1.0 / period) == 0:
                self._report = self._meter.report()


@dataclass(frozen=True)
class _Command:
    action: Callable[[float], Any]
    expires: float
    answer: "Future[Any]"


class ControlLoop(PeriodicThread):
    """Thread that runs the cycle of a robot at its rate.

    Args:
        robot: the robot, owned by the loop from now on.
        on_snapshot: called in the thread after each cycle. It must return quickly and must not raise.
        clock: clock of the thread; None: the machine's.

    Attributes:
        scheduling: real-time scheduling that Linux granted to the thread.
        release_problems: failures of the release at the end of the thread, one sentence each.
    """

    def __init__(
        self, robot: Robot, on_snapshot: Callable[[CycleSnapshot], None], clock: Clock | None = None
    ):
        super().__init__("servo_bus", robot.settings.period, clock)
        self.scheduling = NOT_REQUESTED
        self._robot = robot
        self._on_snapshot = on_snapshot
        self._commands: deque[_Command] = deque()
        self._shutdown_reason: str | None = None
        self._at_once = False
        self._rejects_all = False
        self.release_problems: list[str] = []

    def check(self) -> None:
        """Check that the thread did not end by itself."""
        if not self.alive and not self._robot.closing:
            raise self._ended() from self.failure

    def submit(self, action: Callable[[float], T], lifetime: float = 0.5) -> "Future[T]":
        """Queue an action for the gap between two cycles.

        Args:
            action: called with the time (s, monotonic).
            lifetime: time after which the loop rejects the action with RejectedError, if the action has not begun, s.

        Returns:
            Future of the action's result. It raises DriverError if the thread ends before the action begins.
        """
        command = _Command(action, self._clock() + lifetime, Future())
        self._commands.append(command)
        if self._rejects_all:
            self._reject_waiting()
        return command.answer

    def run(
        self,
        action: Callable[[float], T],
        timeout: float = 2.0,
        undo: Callable[[float], object] | None = None,
        lifetime: float = 0.5,
    ) -> T:
        """Submit an action, wait for its result and return it.

        If the timeout expires before the action has begun, the action never runs, unless its lifetime is infinite. If
        the timeout expires later, ``undo`` runs after the action, unless the thread ends before.

        Args:
            action: called with the time (s, monotonic).
            timeout: longest wait for the result, s.
            undo: action that reverts this one.
            lifetime: see `submit`.
        """
        answer = self.submit(action, lifetime)
        timeout = max(timeout, self._clock.least_timeout)
        try:
            return answer.result(timeout)
        except TimeoutError:
            withdrawn = math.isfinite(lifetime) and answer.cancel()
            if undo is not None and not withdrawn:
                self.submit(undo, lifetime=math.inf)
            if self.failure is not None:
                raise self._ended() from None
            raise DriverError(
                f"the servo bus thread did not respond within {timeout:g} s"
            ) from None

    def _ended(self) -> DriverError:
        cause = "the robot was closed" if self.failure is None else repr(self.failure)
        return DriverError(f"the servo bus thread has ended: {cause}")

    def shutdown(self, reason: str) -> None:
        """Request the thread to bring the robot to rest, to release it and to end.

        The method returns at once. Later calls have no effect. Safe in a signal handler.

        A stop interrupts the return to rest. The thread then ends without moving the robot further. It does not release
        a robot that would spring back.
        """
        if self._shutdown_reason is None:
            self._robot.closing = True
            self._shutdown_reason = reason

    def release_at_once(self) -> None:
        """Request the thread to release the robot at its present position and to end.

        Only an operator may request this. The method returns at once. Safe in a signal handler.
        """
        self._at_once = True
        self.request_end()

    def join(self, timeout: float, meanwhile: Callable[[], None] = lambda: None) -> bool:
        """Wait for the thread to end. After the timeout, end it after its present step, even if the robot moves.

        Args:
            timeout: longest wait, s.
            meanwhile: called every few milliseconds.

        Returns:
            True if the thread has ended.
        """
        end = time.monotonic() + max(timeout, self._clock.least_timeout)
        while self.alive and time.monotonic() < end:
            meanwhile()
            time.sleep(0.005)
        return self.end(timeout=1.0)

    def _step(self, now: float) -> bool:
        shutting_down = self._shutdown_reason is not None
        if self._shutdown_reason:
            self._robot.close(now, self._shutdown_reason)
            self._shutdown_reason = ""
        before = self._robot.active
        if self._serve(now) and not (before and self._robot.active):
            self._excused = True  # setup and release of the servos take many cycles
        self._on_snapshot(self._robot.cycle(now))
        return not (shutting_down and self._robot.is_closed(now))

    def _serve(self, now: float) -> bool:
        """Run the waiting commands. Return True if there was one.

        If a command ends a run, the commands after it wait for the next gap. A snapshot then reports the end before
        another run can begin, so that the goal of the first run receives its result.
        """
        served = bool(self._commands)
        run_ended = False
        while self._commands and not run_ended:
            before = self._robot.player.active_run
            command = self._commands.popleft()
            if not command.answer.set_running_or_notify_cancel():
                continue
            if now >= command.expires:
                command.answer.set_exception(
                    RejectedError(
                        "the command is stale: the control loop took too long to reach it"
                    )
                )
                continue
            try:
                command.answer.set_result(command.action(now))
            except Exception as error:  # noqa: BLE001 (the future passes it to the caller)
                command.answer.set_exception(error)
            run_ended = before is not None and self._robot.player.active_run is None
        return served

    def _reject_waiting(self) -> None:
        """Reject all waiting commands, because the thread has ended. Safe in any thread."""
        with contextlib.suppress(IndexError):  # there is no further command
            while True:
                answer = self._commands.popleft().answer
                if answer.set_running_or_notify_cancel():
                    answer.set_exception(self._ended())

    def _at_start(self) -> None:
        if self._clock.epoch_ns is not None:
            self.scheduling = VIRTUAL
            return
        self.scheduling = request_scheduling(self._robot.settings.real_time_priority)

    def _at_end(self) -> None:
        self.release_problems = self._robot.release() if self._at_once else self._robot.shutdown()
        if self.scheduling not in (NOT_REQUESTED, VIRTUAL):
            return_to_normal()
        self._clock.close()  # otherwise the time of a virtual robot would stop
        # Set the flag first. Then `submit` itself rejects a command that comes too late for the next line.
        self._rejects_all = True
        self._reject_waiting()


class PowerLoop(PeriodicThread):
    """Thread that samples the power sensor at a fixed rate, on a bus that no other thread uses.

    Args:
        sensor: the sensor, set up.
        period: sampling period, s.
        on_sample: called in the thread with each sample. It must return quickly and must not raise.
        clock: clock of the thread; None: the machine's.

    Attributes:
        valid_samples: number of valid samples since the start.
    """

    def __init__(
        self,
        sensor: INA219,
        period: float,
        on_sample: Callable[[PowerSample], None],
        clock: Clock | None = None,
    ):
        super().__init__("power_sensor", period, clock)
        self.valid_samples = 0
        self._sensor = sensor
        self._on_sample = on_sample

    def close(self) -> None:
        """End the thread and close the bus."""
        self.end(timeout=max(2.0, self._clock.least_timeout))
        self._sensor.device.close()
        self._clock.close()

    def _step(self, now: float) -> bool:
        sample = self._sensor.sample(now)
        self.valid_samples += sample.status is SampleStatus.VALID
        self._on_sample(sample)
        return True
