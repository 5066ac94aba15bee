# SPDX-License-Identifier: Apache-2.0
"""The thread that owns the robot, and the one that owns the power sensor.

Whoever wants something of the robot submits a command, which runs between two cycles. Snapshots go out through a
callback. However the thread ends, the robot is released first, over serial, with nothing of ROS.
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
from worm_driver.control.real_time import NOT_ASKED, VIRTUAL, ask_for_urgency, return_to_normal
from worm_driver.control.robot import Robot
from worm_driver.control.telemetry import Snapshot
from worm_driver.control.timing import DeadlineGrid, PeriodMeter, TimingReport
from worm_driver.errors import DriverError, LimitError, PowerSensorError
from worm_driver.power.ina219 import INA219, PowerSample, SampleStatus

T = TypeVar("T")

#: bus errors in a row after which the power sensor's bus is opened anew
_ERRORS_TO_REOPEN = 100


class PeriodicThread:
    """Calls a step on a grid of deadlines, in a thread of its own, until it is told to end or the step says so.

    Args:
        name: of the thread.
        period: s.
        clock: which it goes by; None: the machine's.

    Attributes:
        failure: the exception that ended the thread.
    """

    def __init__(self, name: str, period: float, clock: Clock | None = None):
        self._clock: Clock = MachineClock() if clock is None else clock
        self.failure: Exception | None = None
        self._ending = threading.Event()
        self._meter = PeriodMeter(period)
        self._report = self._meter.report()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._excused = False  # set in a step: that it takes time is meant to be, and counts as no missed deadline

    def _step(self, now: float) -> bool:
        """What is done at a time (s, monotonic); False ends the thread."""
        raise NotImplementedError

    def _at_start(self) -> None:
        """Called in the thread before its first step."""

    def _at_end(self) -> None:
        """Called in the thread when it ends, also by an exception."""

    def start(self) -> None:
        """Starts the thread."""
        self._thread.start()

    def ask_to_end(self) -> None:
        """Lets the thread end after its step. Safe in a signal handler."""
        self._ending.set()

    def end(self, timeout: float) -> bool:
        """Lets the thread end after its step; whether it has within the time (s)."""
        self.ask_to_end()
        self._thread.join(timeout)
        return not self._thread.is_alive()

    @property
    def alive(self) -> bool:
        """Whether the thread runs."""
        return self._thread.is_alive()

    def report(self) -> TimingReport:
        """How well the deadlines were kept; made once a second by the thread itself."""
        return self._report

    def _run(self) -> None:
        try:
            self._at_start()
            self._cycles()
        except Exception as error:  # noqa: BLE001 (whatever it was, the robot must be released, and the node told)
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
    """Runs a robot's cycle at its rate.

    Args:
        robot: which the loop owns from now on.
        on_snapshot: called in the thread after each cycle; must be quick and must not raise.

    Attributes:
        urgency: what the thread has of the real-time priority in the robot's settings.
    """

    def __init__(
        self, robot: Robot, on_snapshot: Callable[[Snapshot], None], clock: Clock | None = None
    ):
        super().__init__("servo_bus", robot.settings.period, clock)
        self.urgency = NOT_ASKED
        self._robot = robot
        self._on_snapshot = on_snapshot
        self._commands: deque[_Command] = deque()
        self._leaving: str | None = None
        self.release_problems: list[str] = []

    def check(self) -> None:
        """Raises DriverError when the thread has ended, with what ended it."""
        if not self.alive:
            raise self._ended() from self.failure

    def submit(self, action: Callable[[float], T], patience: float = 0.5) -> "Future[T]":
        """Has an action called with the time (s, monotonic) between two cycles.

        A command that could not be carried out for ``patience`` s is stale, and is refused with LimitError.
        """
        command = _Command(action, self._clock() + patience, Future())
        self._commands.append(command)
        return command.answer

    def ask(
        self,
        action: Callable[[float], T],
        timeout: float = 2.0,
        undo: Callable[[float], object] | None = None,
    ) -> T:
        """As submit, and waits for the result. Raises DriverError, also when none came in time (s).

        What had not begun by then never will; what had is followed at once by ``undo``.
        """
        answer = self.submit(action)
        timeout = max(timeout, self._clock.patience)
        try:
            return answer.result(timeout)
        except TimeoutError:
            if not answer.cancel() and undo is not None:
                self.submit(undo, patience=math.inf)
            raise self._silent(timeout) from None

    def insist(self, action: Callable[[float], T], timeout: float = 2.0) -> T:
        """As ask, but the action is carried out however late. Raises DriverError."""
        timeout = max(timeout, self._clock.patience)
        try:
            return self.submit(action, patience=math.inf).result(timeout)
        except TimeoutError:
            raise self._silent(timeout) from None

    def _silent(self, timeout: float) -> DriverError:
        if self.failure is not None:
            return self._ended()
        return DriverError(f"the servo bus thread did not respond within {timeout:g} s")

    def _ended(self) -> DriverError:
        return DriverError(f"the servo bus thread has ended: {self.failure!r}")

    def leave(self, reason: str) -> None:
        """Has the robot brought to rest and released, and the thread end after it. Safe in a signal handler."""
        self._leaving = reason

    def join(self, timeout: float, meanwhile: Callable[[], None] = lambda: None) -> bool:
        """Waits for the thread to end; when the time (s) is up it ends after its step, releasing the robot.

        ``meanwhile`` is called every few milliseconds.
        """
        end = time.monotonic() + max(timeout, self._clock.patience)
        while self.alive and time.monotonic() < end:
            meanwhile()
            time.sleep(0.005)
        return self.end(timeout=1.0)

    def _step(self, now: float) -> bool:
        leaving = self._leaving is not None
        if self._leaving:
            self._robot.begin_release(now, self._leaving)
            self._leaving = ""
        before = self._robot.active
        if self._serve(now) and not (before and self._robot.active):
            self._excused = True  # setting servos up, or letting go of them, takes many cycles
        self._on_snapshot(self._robot.cycle(now))
        return not (leaving and self._robot.released)

    def _serve(self, now: float) -> bool:
        """Carries the commands out; whether there was one."""
        served = bool(self._commands)
        while self._commands:
            command = self._commands.popleft()
            if not command.answer.set_running_or_notify_cancel():
                continue
            if now >= command.expires:
                command.answer.set_exception(
                    LimitError("the command is stale: the control loop took too long to reach it")
                )
                continue
            try:
                command.answer.set_result(command.action(now))
            except Exception as error:  # noqa: BLE001 (the one who asked gets it)
                command.answer.set_exception(error)
        return served

    def _at_start(self) -> None:
        if self._clock.epoch_ns is not None:
            self.urgency = VIRTUAL
            return
        self.urgency = ask_for_urgency(self._robot.settings.real_time_priority)

    def _at_end(self) -> None:
        self.release_problems = self._robot.release()
        if self.urgency not in (NOT_ASKED, VIRTUAL):
            return_to_normal()
        self._clock.close()  # a thread that has ended must not keep a virtual robot's time
        self._serve(math.inf)


class PowerLoop(PeriodicThread):
    """Samples the power sensor at a rate, on a bus that no other thread uses.

    The sensor is set up, the period is in s. ``on_sample`` is called in the thread; it must be quick and not raise.
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
        self._errors = 0
        self._sensor = sensor
        self._on_sample = on_sample

    def close(self) -> None:
        """Ends the thread and gives the bus back."""
        self.end(timeout=max(2.0, self._clock.patience))
        self._sensor.device.close()
        self._clock.close()

    def _step(self, now: float) -> bool:
        sample = self._sensor.sample(now)
        self._revive(sample.status)
        self.valid_samples += sample.status is SampleStatus.VALID
        self._on_sample(sample)
        return True

    def _revive(self, status: SampleStatus) -> None:
        """Opens the bus anew now and then while nothing but errors comes from it."""
        self._errors = self._errors + 1 if status is SampleStatus.BUS_ERROR else 0
        if self._errors and self._errors % _ERRORS_TO_REOPEN == 0:
            with contextlib.suppress(PowerSensorError):
                self._sensor.device.reopen()
