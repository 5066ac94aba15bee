# SPDX-License-Identifier: Apache-2.0
"""Rows on servos and sensor against the virtual robot, byte for byte. Each fault turns one row; nothing is written."""

import errno
import re
from collections.abc import Callable, Sequence
from dataclasses import replace

import pytest
import serial
from driver_rig import Bench, Clock, DirectSMBus, idle, installed_robot, moving, settings

from worm_driver.control.bench_check import Row, SensorCheck, ServoCheck, State, open_port
from worm_driver.power import i2c, ina219
from worm_driver.servos import serial_port
from worm_driver.virtual_robot.virtual_robot import VirtualRobot
from worm_driver.virtual_robot.wire.faults import make_fault

LONG = 1e4  # s
Change = Callable[[VirtualRobot], object]


def left(number: int, **values: int) -> Change:
    """Return a change that leaves register values in a servo, as another program does."""

    def change(robot: VirtualRobot) -> None:
        servo = next(servo for servo in robot.servos if servo.servo_id == number)
        for name, value in values.items():
            servo.memory[name] = value

    return change


def fault(name: str, **arguments: object) -> Change:
    return lambda robot: robot.board.add(make_fault(name, **arguments))


def servo_rows(
    change: Change, robot: VirtualRobot | None = None, **changed: object
) -> tuple[dict[str, Row], Bench]:
    robot = robot or VirtualRobot(installed_robot())
    bench = Bench(robot.receive)
    bench.clock.now = robot.time
    change(robot)
    given = settings(**changed)
    bench.bus.set_baud_rate(given.baud_rate)
    rows = ServoCheck(given, bench.bus).rows()
    assert [row.name for row in rows] == list(ServoCheck.NAMES)
    return {row.name: row for row in rows}, bench


def turned(rows: Sequence[Row]) -> list[str]:
    return [row.name for row in rows if row.state in (State.WARNING, State.FAILED)]


FAILED, WARNING = State.FAILED, State.WARNING


@pytest.mark.parametrize(
    ("change", "name", "state", "found", "remedy"),
    [
        (fault("no_answer", target=11, duration=LONG), "ids", FAILED, "servo 11", "its power"),
        (fault("vanished", target=11, duration=LONG), "ids", FAILED, "servo 11", "its power"),
        (fault("corrupted_crc", target=11, duration=LONG), "ids", FAILED, "garbled", "its cable"),
        (fault("truncated", target=11, duration=LONG), "ids", FAILED, "servo 11", "its cable"),
        (fault("late", target=11, duration=LONG), "ids", FAILED, "servo 11", "latency timer"),
        (fault("duplicated", target=11, duration=LONG), "ids", FAILED, "11", "has its id"),
        (fault("wrong_id", target=11, duration=LONG, value=12), "ids", FAILED, "12", "has its id"),
        (fault("error", target=11, duration=LONG), "ids", FAILED, "servo 11", ""),
        (fault("overload", target=1), "hardware errors", FAILED, "servo 1 .*overload", "reboot"),
        (fault("overheating", duration=LONG), "temperatures", FAILED, "servo 12", "reboot"),
        (fault("input_voltage", target=1, duration=LONG), "supply voltage", FAILED, "4.0 V", "supply"),
        (left(1, model_number=350), "models", FAILED, "350", "XM430"),
        (left(12, firmware_version=30), "firmware", FAILED, "servo 12 .*30", "update"),
        (left(1, profile_acceleration=5), "registers", WARNING, "profile_acceleration 5", "driver"),
        (left(1, goal_pwm=120), "registers", WARNING, "servo 1 .*goal_pwm 120", "driver"),
        (left(1, pwm_limit=120), "registers", FAILED, "pwm_limit 120", "setup_servo"),
        (left(1, velocity_limit=9), "registers", FAILED, "velocity_limit 9", "setup_servo"),
        (left(11, max_position_limit=2000), "registers", FAILED, "servo 11 .*2000", "4095"),
        (left(11, status_return_level=1), "registers", WARNING, "status_return_level 1", "driver"),
        (left(11, status_return_level=0), "registers", WARNING, "servo 11 ", "configure"),
        (left(1, torque_enable=1, led=0), "torque", FAILED, "servo 1", "program that switched it on"),
        (left(12, torque_enable=1), "torque", WARNING, "torque of 12 ", "program"),
    ],
)  # fmt: skip
def test_a_fault_turns_one_row_and_nothing_is_written(change, name, state, found, remedy):
    rows, bench = servo_rows(change)
    assert turned(list(rows.values())) == [name], rows
    row = rows[name]
    assert row.state is state
    assert re.search(found, row.found), row
    assert remedy in row.remedy
    assert bench.written == []


#: faults that one exchange hides from the next, and faults that show only when the robot moves
ONCE = ("no_answer", "corrupted_crc", "truncated", "duplicated", "late", "fuzzed")
UNSEEN = ("wrong_position", "stalled", "put_back", "occluded", "slope", "tether")


@pytest.mark.parametrize(
    "change", [*map(fault, ONCE), *(fault(name, duration=LONG) for name in UNSEEN)]
)
def test_a_healthy_robot_is_green_also_with_what_cannot_be_seen(change):
    rows, bench = servo_rows(change)
    assert {row.state for row in rows.values()} == {State.OK}, rows
    assert bench.written == []


def test_a_wrong_baud_rate_is_named():
    rows, bench = servo_rows(lambda _: None, baud_rate=57_600)
    assert turned(list(rows.values())) == ["ids"]
    assert "1, 11, 12" in rows["ids"].found
    assert "set baud_rate to 1000000" in rows["ids"].remedy
    assert bench.bus.port.baudrate == 57_600
    assert {row.state for row in list(rows.values())[1:]} == {State.SKIPPED}


def test_no_servo_at_all_and_one_too_many():
    rows, _ = servo_rows(fault("vanished", duration=LONG))
    assert "any baud rate" in rows["ids"].found
    assert "supply" in rows["ids"].remedy
    rows, _ = servo_rows(
        lambda _: None, fin_ids=(11,), forward_angles=(2.356,), reverse_angles=(3.9,)
    )
    assert turned(list(rows.values())) == ["ids"]
    assert rows["ids"].state is State.WARNING
    assert "12" in rows["ids"].found


def test_an_earlier_driver_left_the_robot_at_rest_or_contracted():
    rig = idle()
    assert rig.end() == []
    rows, _ = servo_rows(lambda _: None, rig.virtual)
    assert turned(list(rows.values())) == []
    rows, bench = servo_rows(lambda _: None, moving().virtual)
    assert turned(list(rows.values())) == ["torque"]
    assert rows["torque"].state is State.WARNING
    assert "contracted by" in rows["torque"].found
    assert "activate" in rows["torque"].remedy
    assert bench.written == []


# --- the serial port ------------------------------------------------------------------------------


def test_a_missing_port_and_a_forbidden_one(tmp_path, monkeypatch, terminal):
    bus, rows = open_port(settings(port=str(tmp_path / "none")))
    assert bus is None
    assert turned(rows) == ["port"]
    assert "plug the adapter in" in rows[0].remedy

    def forbidden(*_: object, **__: object) -> None:
        raise serial.SerialException(errno.EACCES, "could not open port")

    monkeypatch.setattr(serial, "Serial", forbidden)
    _, rows = open_port(settings(port=terminal))
    assert turned(rows) == ["permissions"]
    assert "dialout" in rows[1].remedy


@pytest.mark.parametrize(("timer", "state"), [(1, "ok"), (2, "warning"), (16, "failed")])
def test_the_latency_timer(timer, state, monkeypatch, terminal):
    monkeypatch.setattr(serial_port, "latency_timer_ms", lambda _: timer)
    bus, rows = open_port(settings(port=terminal))
    bus.close()
    assert [row.state.value for row in rows] == ["ok", "ok", state]
    assert ("udev" in rows[2].remedy) == (timer > 1)


# --- the power sensor -----------------------------------------------------------------------------


def sensor_rows(monkeypatch, change: Change, robot: VirtualRobot | None = None, **changed: object):
    robot, clock = robot or VirtualRobot(installed_robot()), Clock()
    change(robot)
    device = i2c.I2CDevice(DirectSMBus(robot, clock), "1", 0x40)
    monkeypatch.setattr(device, "write", None)  # the check only reads
    monkeypatch.setattr(i2c, "open_device", lambda *_: device)
    return {row.name: row for row in SensorCheck(settings(**changed), clock).rows()}


def chip(register: int, value: int) -> Change:
    return lambda robot: robot.chip.write(register, value)


@pytest.mark.parametrize(
    ("change", "name", "state", "remedy"),
    [
        (fault("i2c_nack"), "power sensor", FAILED, "i2cdetect"),
        (fault("i2c_timeout"), "power sensor", FAILED, "Switch its power off"),
        (fault("ina219_overflow", duration=LONG), "power sensor", FAILED, "ina219"),
        (fault("ina219_overflow"), "power sensor", WARNING, "ina219"),
        (fault("ina219_saturation", duration=LONG, value=-2.5), "current sign", FAILED, "IN+"),
        (chip(ina219.CALIBRATION, 1000), "power sensor calibration", WARNING, "the driver sets it"),
        (chip(ina219.CONFIGURATION, 0x019F), "power sensor", WARNING, "the driver resets"),
    ],
)
def test_a_fault_of_the_sensor_turns_one_row(monkeypatch, change, name, state, remedy):
    rows = sensor_rows(monkeypatch, change)
    assert turned(list(rows.values())) == [name], rows
    assert rows[name].state is state
    assert remedy in rows[name].remedy


def test_a_healthy_sensor_is_green_before_and_after_a_driver(monkeypatch):
    for change in (lambda _: None, fault("ina219_reset"), chip(ina219.CALIBRATION, 4194)):
        rows = sensor_rows(monkeypatch, change)
        assert [row.state for row in rows.values()] == [State.OK] * 4, rows


def test_noise_a_wrong_range_and_no_sensor(monkeypatch):
    usual = installed_robot()
    loud = VirtualRobot(replace(usual, supply=replace(usual.supply, power_noise=1.0)))
    assert turned(list(sensor_rows(monkeypatch, lambda _: None, loud).values())) == [
        "current noise"
    ]
    rows = sensor_rows(monkeypatch, lambda _: None, max_current=5.0)
    assert turned(list(rows.values())) == ["power sensor calibration"]
    assert "at most 3.2 A" in rows["power sensor calibration"].remedy
    rows = sensor_rows(monkeypatch, lambda _: None, i2c_bus="none")
    assert {row.state for row in rows.values()} == {State.SKIPPED}


def test_a_missing_bus_and_swapped_bytes(monkeypatch):
    rows = SensorCheck(settings(i2c_bus="/dev/none"), Clock()).rows()
    assert turned(rows) == ["power sensor"]
    assert "enable I2C" in rows[0].remedy
    monkeypatch.setattr(i2c.I2CDevice, "read", lambda *_: 0x9F39)
    rows = list(sensor_rows(monkeypatch, lambda _: None).values())
    assert turned(rows) == ["power sensor"]
    assert "0x9F39" in rows[0].remedy
