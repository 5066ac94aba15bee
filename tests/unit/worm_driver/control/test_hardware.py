# SPDX-License-Identifier: Apache-2.0
"""The devices of a configured driver, with the virtual robot behind a real pty and a real socket."""

import math
import re
from collections import deque
from collections.abc import Iterator
from dataclasses import replace

import pytest
from driver_rig import settings
from waiting import TIMEOUT_S, wait_for

from worm_driver.control import hardware as hardware_module
from worm_driver.control.diagnostics import Level
from worm_driver.control.driver_settings import DriverSettings
from worm_driver.control.hardware import Hardware
from worm_driver.driver_errors import DriverError, PortError
from worm_driver.gait.gait_player import Phase
from worm_driver.servos import serial_port
from worm_driver.servos.servo_bus import BusPort
from worm_driver.virtual_robot.wire.faults import make_fault
from worm_msgs.gait import Gait


@pytest.fixture
def served(serve):
    return serve(1.0)


@pytest.fixture
def given(served) -> DriverSettings:
    """Return settings with long timeouts: driver and robot share one interpreter here."""
    return settings(
        port=served.port,
        i2c_bus=served.socket,
        watchdog=2.0,
        max_silence=1.0,
        max_following_error=0.1,
    )


@pytest.fixture
def hardware(given) -> Iterator[Hardware]:
    hardware = Hardware(given)
    yield hardware
    hardware.close("the test is over")


def test_a_robot_without_a_reader_is_held(hardware, monkeypatch):
    monkeypatch.setattr(hardware_module, "_LISTENING_TIMEOUT", math.inf)
    hardware.loop.run(hardware.robot.activate)
    hardware.loop.run(lambda now: hardware.robot.start(now, Gait(0.05, 0.2), 5))
    monkeypatch.setattr(hardware_module, "_LISTENING_TIMEOUT", 0.3)
    wait_for(lambda: hardware.robot.player.phase is Phase.FAULT)
    assert "has not read" in hardware.robot.player.message


class Emptied(deque):
    """Queue whose elements the publishing thread removes immediately."""

    def append(self, _) -> None:
        self.clear()


def test_a_snapshot_that_is_read_at_once_does_not_end_the_loop(hardware):
    hardware.snapshots = Emptied()
    done = hardware.loop.report().cycles
    wait_for(lambda: hardware.loop.report().cycles > done + 50 or not hardware.loop.alive)
    assert hardware.loop.alive, hardware.loop.failure


@pytest.mark.parametrize(
    ("afterwards", "rate", "quiet_time"), [(1, 100.0, 0.004), (16, 20.0, 0.034)]
)
def test_the_latency_timer_counts_that_the_open_port_has(
    given, monkeypatch, afterwards, rate, quiet_time
):
    """It is 16 ms until the port is open and the driver has set a shorter one."""
    timers, set_up = [16], BusPort.setupPort

    def opened(port: BusPort, baud_rate: int) -> bool:
        timers.append(afterwards)
        return set_up(port, baud_rate)

    monkeypatch.setattr(serial_port, "latency_timer_ms", lambda _: timers[-1])
    monkeypatch.setattr(BusPort, "setupPort", opened)
    hardware = Hardware(replace(given, rate=rate))
    assert hardware.robot.bus.port.quiet_time == pytest.approx(quiet_time)
    hardware.close("over")


@pytest.mark.parametrize(
    "change", [{"port": "/dev/no_worm"}, {"i2c_bus": "/dev/i2c-77"}], ids=["port", "sensor"]
)
def test_what_fails_to_open_leaves_nothing_open(given, change):
    with pytest.raises(DriverError):
        Hardware(replace(given, **change))
    Hardware(given).close("over")


def test_a_second_opener_is_rejected_and_the_first_continues(hardware, given):
    with pytest.raises(PortError, match="in use"):
        Hardware(given)
    count = len(hardware.snapshots)
    wait_for(lambda: len(hardware.snapshots) > count + 10)


def test_without_a_power_sensor_there_are_no_samples_and_no_report_of_one(given):
    hardware = Hardware(replace(given, i2c_bus=""))
    wait_for(lambda: len(hardware.snapshots) > 5)
    names = [report.name for report in hardware.report(hardware.snapshots[-1])]
    assert "driver: power sensor" not in names
    assert not hardware.samples
    hardware.close("over")


def test_a_shunt_with_swapped_inputs_is_a_warning_in_the_diagnostics(served, given):
    served.robot.board.add(make_fault("ina219_saturation", value=-2.5, duration=math.inf))
    hardware = Hardware(given)
    wait_for(lambda: len(hardware.samples) > 10)
    report = next(r for r in hardware.report(hardware.snapshots[-1]) if "power" in r.name)
    hardware.close("over")
    assert report.level is Level.WARN
    assert "IN+ and IN-" in report.message


def test_a_release_that_no_servo_acknowledges_is_reported_until_one_does(hardware, served):
    def released() -> list[str]:
        return [r.message for r in hardware.report(hardware.snapshots[-1]) if "release" in r.name]

    hardware.loop.run(hardware.robot.activate)
    served.robot.board.add(make_fault("no_answer", duration=1e6))
    hardware.loop.run(lambda _: hardware.robot.release(), timeout=TIMEOUT_S)
    assert "torque may still be on: servo 1 does not answer" in released()[0]
    served.robot.board.clear()
    hardware.loop.run(lambda _: hardware.robot.release(), timeout=TIMEOUT_S)
    assert released() == []


def test_it_reports_the_devices_found(hardware):
    lines = hardware.description()
    assert lines[0] == "servo 1: XM430-W350-T, firmware 48"
    assert re.findall(r"[\d.]+ (?:m/s|Hz|m)\b", lines[3]) == ["0.09 m", "0.4 Hz", "0.1198 m/s"]
