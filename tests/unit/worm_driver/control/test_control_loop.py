# SPDX-License-Identifier: Apache-2.0
"""The threads around the robot, with a robot that only counts calls."""

import math
import threading
import time
from types import SimpleNamespace

import pytest
from driver_rig import Clock
from waiting import TIMEOUT_S, wait_for

from worm_driver.control.control_loop import ControlLoop, PowerLoop
from worm_driver.driver_errors import DriverError, RejectedError
from worm_driver.power.ina219 import PowerSample, SampleStatus


class NotingRobot:
    """Robot that counts cycles, and needs a few of them to come to rest."""

    settings = SimpleNamespace(period=0.002, real_time_priority=0)
    player = SimpleNamespace(active_run=None)

    def __init__(self) -> None:
        self.cycles = 0
        self.active = False
        self.closing = False
        self.until_rest = 5
        self.releasing = ""
        self.releases = 0
        self.threads: set[str] = set()
        self.failure: Exception | None = None

    def cycle(self, now: float) -> float:
        self.cycles += 1
        self.threads.add(threading.current_thread().name)
        if self.failure is not None:
            raise self.failure
        if self.releasing:
            self.until_rest -= 1
        return now

    def close(self, now: float, reason: str) -> None:
        self.releasing = reason

    def is_closed(self, now: float) -> bool:
        return bool(self.releasing) and self.until_rest <= 0

    def shutdown(self) -> list[str]:
        return self.release()

    def release(self) -> list[str]:
        self.releases += 1
        return ["a servo kept silent"]


@pytest.fixture
def robot() -> NotingRobot:
    return NotingRobot()


@pytest.fixture
def loop(robot):
    loop = ControlLoop(robot, lambda _: None)
    loop.start()
    yield loop
    loop.shutdown("the test is over")
    loop.join(TIMEOUT_S)


def test_every_cycle_is_handed_over_in_order_and_one_thread_owns_the_robot(robot):
    seen: list[float] = []
    loop = ControlLoop(robot, seen.append)
    loop.start()
    wait_for(lambda: robot.cycles >= 50)
    loop.shutdown("over")
    assert loop.join(TIMEOUT_S)
    assert len(seen) == robot.cycles
    assert seen == sorted(seen)
    assert robot.threads == {"servo_bus"}


def test_a_command_runs_in_the_robots_thread_and_gives_its_result_or_exception_back(loop):
    answer = loop.submit(lambda now: (threading.current_thread().name, now))
    name, now = answer.result(TIMEOUT_S)
    assert name == "servo_bus"
    assert now == pytest.approx(time.monotonic(), abs=TIMEOUT_S)

    def reject(_: float) -> None:
        raise RejectedError("too long")

    with pytest.raises(RejectedError, match="too long"):
        loop.submit(reject).result(TIMEOUT_S)
    assert loop.alive


def test_a_stale_command_is_rejected_and_not_executed(loop):
    done: list[float] = []
    late = loop.submit(done.append, lifetime=-1.0)
    with pytest.raises(RejectedError, match="stale"):
        late.result(TIMEOUT_S)
    assert done == []


class Slow:
    """Activation that lasts until the test ends it."""

    def __init__(self, robot: NotingRobot) -> None:
        self.robot = robot
        self.begun = threading.Event()
        self.may_end = threading.Event()
        self.active = False

    def activate(self, _: float) -> None:
        self.begun.set()
        self.may_end.wait(TIMEOUT_S)
        self.active = True

    def release(self, _: float) -> None:
        self.active = False
        self.robot.release()


def test_an_activation_that_takes_too_long_is_undone_when_it_ends(robot, loop):
    slow = Slow(robot)
    with pytest.raises(DriverError, match="did not respond"):
        loop.run(slow.activate, timeout=0.05, undo=slow.release)
    after = loop.submit(lambda _: slow.active)
    slow.may_end.set()
    assert after.result(TIMEOUT_S) is False  # later commands find the robot released
    assert robot.releases == 1


def test_of_the_commands_given_up_in_the_queue_only_one_without_deadline_is_carried_out(
    robot, loop
):
    slow, done = Slow(robot), []
    loop.submit(slow.activate)
    assert slow.begun.wait(TIMEOUT_S)
    with pytest.raises(DriverError, match="did not respond"):
        loop.run(lambda _: done.append("late"), timeout=0.01, undo=lambda _: done.append("undone"))
    with pytest.raises(DriverError, match="did not respond"):
        loop.run(lambda _: done.append("executed"), timeout=0.01, lifetime=math.inf)
    slow.may_end.set()
    loop.submit(lambda _: None).result(TIMEOUT_S)
    assert done == ["executed"]


def test_leaving_twice_begins_one_return_and_releases_once_at_rest(robot, loop):
    robot.until_rest = 10**9
    loop.shutdown("the signal")
    wait_for(lambda: robot.releasing)
    loop.shutdown("the end of the node")
    done = robot.cycles
    wait_for(lambda: robot.cycles > done + 5)
    assert robot.releasing == "the signal"
    assert robot.releases == 0
    robot.until_rest = 0
    assert loop.join(TIMEOUT_S)
    assert robot.releases == 1
    assert loop.release_problems == ["a servo kept silent"]


@pytest.mark.parametrize("place", ["cycle", "hand over"])
def test_an_exception_releases_the_robot_and_is_kept(robot, place):
    error = RuntimeError("a bug")

    def publish(_: object) -> None:
        if place == "hand over":
            raise error

    robot.failure = error if place == "cycle" else None
    loop = ControlLoop(robot, publish)
    loop.start()
    wait_for(lambda: not loop.alive)
    assert robot.releases == 1
    assert loop.failure is error
    with pytest.raises(DriverError, match="has ended: RuntimeError"):
        loop.check()
    with pytest.raises(DriverError, match="has ended: RuntimeError"):
        loop.run(lambda _: 1, timeout=0.01)


@pytest.mark.parametrize("failure", [None, RuntimeError("a bug")])
def test_a_command_that_waits_at_the_end_is_rejected_with_the_end(robot, loop, failure):
    """Not as a stale command: a command without a deadline cannot be stale."""
    waiting, done = [], []

    def release() -> list[str]:
        waiting.append(loop.submit(done.append, lifetime=math.inf))
        return []

    robot.release, robot.failure = release, failure
    loop.release_at_once()
    assert loop.join(TIMEOUT_S)
    error = waiting[0].exception(TIMEOUT_S)
    assert type(error) is DriverError
    assert "has ended" in str(error)
    assert (failure is None) == (repr(failure) not in str(error))
    assert done == []


def test_commands_that_are_submitted_during_the_end_are_all_answered(robot, loop):
    answers = []

    def submit_until_the_end() -> None:
        while loop.alive:
            answers.append(loop.submit(lambda _: 1, lifetime=math.inf))
            answers[-1].exception(TIMEOUT_S)

    threads = [threading.Thread(target=submit_until_the_end) for _ in range(2)]
    for thread in threads:
        thread.start()
    wait_for(lambda: robot.cycles > 3)
    loop.shutdown("over")
    assert loop.join(TIMEOUT_S)
    for thread in threads:
        thread.join(TIMEOUT_S)
    assert all(answer.done() for answer in answers)
    assert any(answer.exception() is None for answer in answers)


@pytest.mark.parametrize(
    ("active", "missed"), [((True, True), 9), ((False, True), 0), ((True, False), 0)]
)
def test_only_setting_up_and_letting_go_may_take_more_than_a_cycle(robot, active, missed):
    """95 ms in a loop of 10 ms are late if the torque is on."""
    clock = Clock()
    robot.settings = SimpleNamespace(period=0.01, real_time_priority=0)
    robot.active, after = active

    def end_in_time(_: object) -> None:
        """End before the report's window has moved on, as this clock runs ahead."""
        if robot.cycles >= 100:
            loop.request_end()

    loop = ControlLoop(robot, end_in_time, clock)

    def long(now: float) -> None:
        clock.now += 0.095
        robot.active = after

    loop.submit(long, lifetime=TIMEOUT_S)
    loop.start()
    assert loop.join(TIMEOUT_S)
    assert loop.report().missed == missed
    assert (loop.report().max_error < 0.001) == (missed == 0)


class Sensor:
    """Sensor that returns samples of all kinds in turn."""

    def __init__(self) -> None:
        self.count = 0
        self.device = SimpleNamespace(close=lambda: setattr(self, "closed", True))
        self.closed = False

    def sample(self, now: float) -> PowerSample:
        self.count += 1
        status = SampleStatus.VALID if self.count % 2 else SampleStatus.NOT_READY
        return PowerSample(now, status, 12.0, 0.1)


def test_the_power_loop_hands_every_sample_over_and_counts_the_valid_ones():
    sensor, samples = Sensor(), []
    loop = PowerLoop(sensor, 0.001, samples.append)
    loop.start()
    wait_for(lambda: len(samples) >= 20)
    loop.close()
    assert len(samples) == sensor.count
    assert loop.valid_samples == sum(s.status is SampleStatus.VALID for s in samples)
    assert sensor.closed
