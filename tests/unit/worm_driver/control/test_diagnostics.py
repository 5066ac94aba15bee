# SPDX-License-Identifier: Apache-2.0
import math
from dataclasses import replace

import pytest

from worm_driver.control import diagnostics
from worm_driver.control.diagnostics import Level
from worm_driver.control.real_time import NOT_REQUESTED
from worm_driver.control.timing import TimingReport
from worm_driver.gait.gait_player import Phase, PlayerState
from worm_driver.power.ina219 import SampleStatus
from worm_driver.servos.registers import XL430_W250, XM430_W350
from worm_driver.servos.servo_bus import BusCounters
from worm_driver.servos.servo_setup import Servo
from worm_driver.servos.state_reader import SILENT, ServoState

SERVO = Servo(1, XM430_W350, 48, 4.8, (9.5, 16.0), 80.0, (0, 4095))
STATE = ServoState(0, 0.1, 0.2, 0.3, 12.0, 30.0, 1.0)


@pytest.mark.parametrize(
    ("state", "alert", "level", "expected"),
    [
        (STATE, False, Level.OK, "ok"),
        (SILENT, False, Level.ERROR, "does not answer"),
        (STATE, True, Level.ERROR, "hardware error"),
        (replace(STATE, voltage=9.0), False, Level.WARN, "9.5 to 16.0 V"),
        (replace(STATE, temperature=75.0), False, Level.WARN, "shuts down at 80"),
    ],
)
def test_a_servo(state, alert, level, expected):
    report = diagnostics.servo_report(SERVO, state, alert=alert)
    assert (report.level, report.name) == (level, "driver: servo 1")
    assert expected in report.message
    assert report.hardware_id == "XM430-W350-T id 1 firmware 48"
    keys = {key for key, _ in report.values}
    assert keys == {"position_rad", "current_a", "voltage_v", "temperature_deg_c"}


def test_a_servo_without_a_current_sensor_reports_its_load_as_a_ratio():
    servo = replace(SERVO, model=XL430_W250)
    assert (
        dict(diagnostics.servo_report(servo, STATE, alert=False).values)["load_ratio"] == "0.3000"
    )


def test_the_bus_reports_errors_since_the_last_report():
    before = BusCounters(exchanges=100, timeouts=3)
    after = BusCounters(exchanges=200, timeouts=5, stale=1)
    report = diagnostics.bus_report("/dev/worm_bus", after, before, None)
    assert report.level is Level.WARN
    assert report.message == "2 timeouts, 1 stale in the last second"
    assert diagnostics.bus_report("", after, after, 1).level is Level.OK
    slow = diagnostics.bus_report("/dev/ttyUSB0", after, after, 16)
    assert slow.level is Level.WARN
    assert "latency timer is 16 ms: install the udev rule" in slow.message


def test_timing_warns_from_two_milliseconds_on():
    good = TimingReport(0.01, 0.0019, 0.02, 0.0015, 0.006, 1, 1000)
    assert diagnostics.timing_report(good, 0.01, NOT_REQUESTED).level is Level.OK
    late = diagnostics.timing_report(replace(good, p99_error=0.0021), 0.01, NOT_REQUESTED)
    assert late.level is Level.WARN
    assert "2.10 ms" in late.message
    assert "wakes the thread 1.50 ms late" in late.message
    long = diagnostics.timing_report(
        replace(good, p99_error=0.01, p99_cycle=0.014), 0.01, NOT_REQUESTED
    )
    assert "a cycle takes 14.0 ms (p99) of 10" in long.message
    assert "free the machine" not in long.message
    starting = TimingReport(*[math.nan] * 5, 0, 1)
    assert diagnostics.timing_report(starting, 0.01, NOT_REQUESTED).level is Level.OK


@pytest.mark.parametrize(
    ("counts", "level", "expected"),
    [
        ({SampleStatus.VALID: 100}, Level.OK, "ok"),
        ({SampleStatus.VALID: 90, SampleStatus.NOT_READY: 10}, Level.OK, "ok"),
        ({SampleStatus.VALID: 1, SampleStatus.NOT_READY: 99}, Level.WARN, "identical bits"),
        ({SampleStatus.VALID: 90, SampleStatus.OVERFLOW: 10}, Level.WARN, "10 x overflow"),
        ({SampleStatus.VALID: 99, SampleStatus.SENSOR_RESET: 1}, Level.WARN, "1 x sensor reset"),
        ({SampleStatus.BUS_ERROR: 100}, Level.ERROR, "100 x bus error"),
        ({}, Level.ERROR, "no samples"),
    ],
)
def test_the_power_sensor(counts, level, expected):
    report = diagnostics.power_report(counts, "INA219 0x40 on 1", "")
    assert report.level is level
    assert expected in report.message


def test_the_gait():
    fault = PlayerState(phase=Phase.FAULT, message="servo 1 is gone")
    assert diagnostics.gait_report(fault, active=True, homed=True).level is Level.ERROR
    assert "servo 1" in diagnostics.gait_report(fault, active=True, homed=True).message
    idle = PlayerState()
    assert diagnostics.gait_report(idle, active=False, homed=True).message == "torque is off"
    left = diagnostics.gait_report(idle, active=False, homed=True, left_on="torque is on")
    assert (left.level, left.message) == (Level.WARN, "torque is on")
    assert "not homed" in diagnostics.gait_report(idle, active=False, homed=False).message
