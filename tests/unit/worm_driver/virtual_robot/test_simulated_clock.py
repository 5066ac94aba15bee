# SPDX-License-Identifier: Apache-2.0
"""Threads and a virtual robot's time, which wait for each other."""

import math
import threading
import time
from contextlib import closing

import pytest

from worm_driver.clock import MachineClock
from worm_driver.servos.registers import COMMON
from worm_driver.servos.servo_bus import ServoBus
from worm_driver.simulated_clock import I2C, SERIAL, SimulatedClock, clock_of
from worm_driver.virtual_robot.wire.faults import make_fault


@pytest.fixture
def fast(serve):
    """Start a robot whose time runs as fast as possible."""
    return serve(math.inf)


@pytest.fixture
def clock(fast):
    with closing(SimulatedClock(fast.directory, SERIAL)) as clock:
        yield clock


@pytest.fixture
def bus(fast, clock):
    with closing(ServoBus.open(fast.port, 1_000_000, retries=0)) as bus:
        bus.port.go_by(clock)
        yield bus


def test_a_minute_passes_at_once_and_to_the_moment(clock):
    begin = clock()
    clock.sleep_until(begin + 60.0)
    assert clock() == pytest.approx(begin + 60.0, abs=1e-9)
    assert clock.epoch_ns == 10**18


def test_while_a_client_works_no_time_passes(clock):
    now = clock()
    end = time.monotonic() + 0.3
    while time.monotonic() < end:
        assert clock() == now


def test_two_wait_for_each_other(fast):
    """Each notices when the other's last deadline has passed, and misses none of its own."""
    seen: dict[str, list[float]] = {"a": [], "b": []}
    clocks = {name: SimulatedClock(fast.directory, I2C) for name in seen}
    begin = max(clock() for clock in clocks.values())

    def run(name: str, period: float) -> None:
        for n in range(1, 51):
            clocks[name].sleep_until(begin + n * period)
            seen[name].append(clocks[name]() - begin)
        clocks[name].close()

    threads = [threading.Thread(target=run, args=item) for item in (("a", 0.01), ("b", 0.007))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert seen["a"] == pytest.approx([0.01 * n for n in range(1, 51)], abs=1e-9)
    assert seen["b"] == pytest.approx([0.007 * n for n in range(1, 51)], abs=1e-9)


def test_a_missing_answer_takes_its_timeout_and_no_more(fast, bus, clock):
    bus.read(1, COMMON["present_position"])
    fast.server.inject(make_fault("no_answer", target=1))
    clock.sleep_until(clock() + 0.1)
    begin = clock()
    with pytest.raises(Exception, match="does not answer"):
        bus.read(1, COMMON["present_position"])
    assert clock() - begin == pytest.approx(bus.answer_time(4, 1), abs=2e-6)
    bus.read(1, COMMON["present_position"])


def test_a_thousand_questions_are_answered_however_the_line_dawdles(bus):
    """A pseudo-terminal transmits bytes when the kernel has time for it:

    the robot's time must not advance meanwhile.
    """
    for _ in range(1000):
        bus.read(1, COMMON["present_position"])
    assert (bus.counters.timeouts, bus.counters.corrupt) == (0, 0)


def test_an_ended_client_delays_no_other(fast):
    gone, stays = SimulatedClock(fast.directory, I2C), SimulatedClock(fast.directory, I2C)
    gone.close()
    due = stays() + 1.0
    stays.sleep_until(due)
    assert stays() >= due
    stays.close()


def test_after_the_robot_is_gone_time_goes_on(serve):
    robot = serve(1.0)
    clock = SimulatedClock(robot.directory, I2C)
    robot.end()
    before = clock()
    clock.sleep_until(before + 0.05)
    assert before + 0.05 <= clock() < before + 20.0
    clock.close()


def test_in_real_time_and_on_real_devices_the_clock_is_the_machines(serve):
    assert isinstance(clock_of(serve(None).port, SERIAL), MachineClock)
    assert isinstance(clock_of("/dev/ttyUSB0", SERIAL), MachineClock)
    assert isinstance(clock_of("", I2C), MachineClock)


@pytest.mark.parametrize(("device", "port"), [("servo_bus", SERIAL), ("i2c.sock", I2C)])
def test_the_clock_is_found_through_any_link_to_the_device(serve, tmp_path, device, port):
    serve(1.0)
    link, chain = tmp_path / "link", tmp_path / "chain"
    link.symlink_to(tmp_path / "robot" / device)
    chain.symlink_to(link)
    clock = clock_of(str(chain), port)
    assert isinstance(clock, SimulatedClock)
    clock.close()
