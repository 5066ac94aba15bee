# SPDX-License-Identifier: Apache-2.0
"""One virtual servo: which values its registers accept and reject, and its motion."""

from random import Random

import pytest

from worm_driver.servos.registers import EXTENDED_POSITION_MODE
from worm_driver.virtual_robot.servo.control_table import (
    MODELS,
    XM430_W350,
)
from worm_driver.virtual_robot.servo.register_memory import RegisterError
from worm_driver.virtual_robot.servo.virtual_servo import OVERLOAD_ERROR, SPEED_UNIT, Servo
from worm_driver.virtual_robot.wire.packet import ALERT, Error

STEP = 0.001


class Bench:
    """Servo with a clock, read and written by register name."""

    def __init__(self, model=XM430_W350, start=1000.0, **settings):
        self.servo = Servo(model, {"id": 1, **settings}, start, 0.25, Random(1))
        self.servo.voltage = model.nominal_voltage
        self.steps = 0

    @property
    def time(self):
        return self.steps * STEP

    def write(self, name, value):
        row = self.servo.model.registers[name]
        self.servo.write(row.address, row.pack(value))

    def rejected(self, name, value):
        with pytest.raises(RegisterError) as caught:
            self.write(name, value)
        return caught.value.number

    def read(self, name):
        row = self.servo.model.registers[name]
        return row.unpack(self.servo.read(row.address, row.size))

    def run(self, seconds):
        for _ in range(round(seconds / STEP)):
            self.steps += 1
            self.servo.step(self.time, STEP)

    def supervise(self, seconds):
        for _ in range(round(seconds / 0.05)):
            self.run(0.05)
            self.servo.supervise(0.05)


def extended(**settings):
    bench = Bench(operating_mode=EXTENDED_POSITION_MODE, **settings)
    bench.write("torque_enable", 1)
    return bench


@pytest.mark.parametrize("model", MODELS.values(), ids=MODELS)
def test_a_servo_of_each_model_boots_with_its_factory_values(model):
    bench = Bench(model)
    assert bench.read("model_number") == model.number
    assert ("goal_current" in bench.servo.memory) == ("present_load" not in bench.servo.memory)
    for row in model.registers.values():
        if row.writable and row.name not in ("id", "goal_position"):
            assert bench.read(row.name) == row.initial
            assert row.low <= row.initial <= row.high


@pytest.mark.parametrize(
    ("name", "value", "number"),
    [
        ("present_position", 5, Error.ACCESS),
        ("operating_mode", 2, Error.DATA_RANGE),
        ("return_delay_time", 255, Error.DATA_RANGE),
        ("goal_position", 4096, Error.DATA_LIMIT),
        ("goal_velocity", 201, Error.DATA_LIMIT),
        ("goal_current", 1194, Error.DATA_LIMIT),
        ("goal_pwm", -886, Error.DATA_LIMIT),
        ("profile_velocity", 32768, Error.DATA_RANGE),
        ("torque_enable", 2, Error.DATA_RANGE),
    ],
)
def test_invalid_values_are_rejected(name, value, number):
    assert Bench().rejected(name, value) == number


@pytest.mark.parametrize(
    ("address", "data", "number"),
    [
        (116, b"\x00\x00", Error.DATA_LENGTH),  # half a register
        (117, b"\x00\x00\x00\x00", Error.ACCESS),  # not the start of a register
        (92, b"\x00", Error.ACCESS),  # no register there
        (168, b"\x00", Error.ACCESS),  # beyond the table
        # profile and goal; the goal is one pulse beyond 256 turns
        (108, b"\x0a\x00\x00\x00\x14\x00\x00\x00\x00\x00\x10\x00", Error.DATA_RANGE),
    ],
)
def test_a_write_that_is_rejected_changes_nothing(address, data, number):
    bench = extended()
    with pytest.raises(RegisterError) as caught:
        bench.servo.write(address, data)
    assert caught.value.number == number
    assert bench.read("profile_acceleration") == 0


def test_torque_locks_the_eeprom():
    bench = extended()
    assert bench.rejected("operating_mode", 3) == Error.ACCESS
    bench.write("torque_enable", 0)
    bench.write("operating_mode", 3)
    assert bench.read("operating_mode") == 3


def test_a_mode_change_sets_gains_profile_and_goals_back():
    bench = Bench()
    bench.write("position_p_gain", 123)
    bench.write("profile_velocity", 50)
    bench.write("goal_current", 10)
    bench.write("operating_mode", EXTENDED_POSITION_MODE)
    assert bench.read("position_p_gain") == 800
    assert bench.read("profile_velocity") == 0
    assert bench.read("goal_current") == 1193


def test_the_shaft_goes_to_its_goal_and_no_faster_than_it_can():
    bench = extended()
    bench.write("goal_position", 9000)
    bench.run(0.2)
    assert bench.read("present_velocity") * 0.229 == pytest.approx(46.0, abs=0.5)  # rpm at 12 V
    bench.run(3.0)
    assert bench.read("present_position") == pytest.approx(9000, abs=1)


def test_a_profile_limits_speed_and_acceleration():
    bench = extended()
    bench.write("profile_velocity", 100)
    bench.write("profile_acceleration", 20)
    bench.write("goal_position", 1000 + 4096)
    bench.run(0.1)
    planned = bench.servo.motor.trajectory_velocity / SPEED_UNIT
    assert planned == pytest.approx(20 * 214.577 * 0.1 / 60 / 0.229, abs=2)
    bench.run(1.0)
    assert bench.read("present_velocity") == pytest.approx(100, abs=1)
    bench.run(3.0)
    assert bench.read("present_position") == pytest.approx(1000 + 4096, abs=1)


def test_reverse_mode_counts_the_other_way():
    bench = Bench(operating_mode=EXTENDED_POSITION_MODE, drive_mode=0x01)
    bench.write("torque_enable", 1)
    before = bench.read("present_position")
    bench.write("goal_position", before + 100)
    bench.run(0.5)
    assert bench.servo.motor.position == pytest.approx(900, abs=1)
    assert bench.read("present_position") == pytest.approx(before + 100, abs=1)


def test_a_reboot_folds_the_position_and_loses_ram():
    bench = extended()
    bench.write("goal_position", 1000 + 3 * 4096)
    bench.run(5.0)
    bench.servo.reboot(bench.time)
    assert not bench.servo.answers(bench.time + 0.2)
    assert bench.servo.answers(bench.time + 0.3)
    assert bench.read("present_position") == pytest.approx(1000, abs=1)
    assert bench.servo.motor.position == pytest.approx(1000 + 3 * 4096, abs=2)
    assert bench.read("torque_enable") == 0
    assert bench.read("operating_mode") == EXTENDED_POSITION_MODE


def test_the_homing_offset_is_added_after_folding():
    bench = Bench(start=4096.0 * 5 + 10, homing_offset=-500)
    assert bench.read("present_position") == 10 - 500


def test_the_watchdog_stops_the_motor_and_rejects_goals_until_it_is_cleared():
    bench = extended()
    bench.write("profile_velocity", 50)
    bench.write("bus_watchdog", 5)  # 100 ms
    bench.write("goal_position", 1000 + 4096)
    bench.run(0.09)
    assert bench.read("bus_watchdog") == 5
    bench.run(0.02)
    assert bench.read("bus_watchdog") == -1
    stopped_at = bench.servo.motor.position
    bench.run(1.0)
    assert bench.servo.motor.position == stopped_at
    assert bench.read("torque_enable") == 1
    assert bench.read("profile_velocity") == 0
    assert bench.rejected("goal_position", 1100) == Error.DATA_RANGE
    assert bench.rejected("bus_watchdog", 5) == Error.DATA_RANGE
    bench.write("bus_watchdog", 0)
    bench.run(0.5)
    assert bench.servo.motor.position == stopped_at
    bench.write("goal_position", 1100)
    bench.run(0.5)
    assert bench.read("present_position") == pytest.approx(1100, abs=1)


def test_the_watchdog_sleeps_while_torque_is_off():
    bench = Bench()
    bench.write("bus_watchdog", 1)
    bench.run(1.0)
    assert bench.read("bus_watchdog") == 1


def test_a_blocked_shaft_overloads_and_only_a_reboot_helps():
    bench = extended()
    bench.servo.blocked = True
    bench.write("goal_position", 3000)
    bench.supervise(0.5)
    assert bench.read("present_position") == 1000
    assert bench.read("present_current") * 2.69e-3 == pytest.approx(2.3, abs=0.1)
    bench.supervise(1.0)
    assert bench.read("hardware_error_status") == OVERLOAD_ERROR
    assert bench.servo.alert() == ALERT
    assert bench.read("torque_enable") == 0
    assert bench.rejected("torque_enable", 1) == Error.RESULT_FAIL
    bench.servo.blocked = False
    bench.servo.reboot(bench.time)
    bench.write("torque_enable", 1)
    assert bench.servo.alert() == 0


@pytest.mark.parametrize(("gain", "error"), [(800, 69.0), (1600, 34.5)])
def test_a_loaded_shaft_is_behind_its_goal_as_there_is_no_integral_gain(gain, error):
    """The stall torque, 4.1 N*m, needs full output: 885 / (800/128) = 142 pulses."""
    bench = extended()
    bench.write("position_p_gain", gain)
    bench.servo.load = 2.0
    bench.run(0.3)
    assert 1000 - bench.read("present_position") == pytest.approx(error, abs=1.5)
    assert bench.read("present_current") == pytest.approx(2.0 / (4.1 / 2.3) / 2.69e-3, abs=5)
    assert bench.read("position_trajectory") == 1000
    assert bench.read("present_velocity") == 0
    bench.write("goal_position", bench.read("present_position"))
    bench.run(0.3)
    assert 1000 - bench.read("present_position") == pytest.approx(2 * error, abs=3)
    bench.write("position_i_gain", 10)
    bench.run(0.3)
    assert bench.read("present_position") == pytest.approx(1000 - error, abs=3)


def test_a_loaded_shaft_stays_where_it_is_when_its_torque_goes_off_or_its_watchdog_fires():
    bench = extended()
    bench.servo.load = 0.4
    bench.run(0.3)
    loaded = bench.read("present_position")
    bench.write("bus_watchdog", 1)
    bench.run(0.3)
    assert bench.read("bus_watchdog") == -1
    assert bench.read("present_position") == loaded
    bench.write("bus_watchdog", 0)
    bench.write("torque_enable", 0)
    bench.run(0.3)
    assert bench.read("present_position") == loaded


def test_a_limp_shaft_gives_way_to_a_load_that_beats_its_friction():
    bench = Bench()
    bench.servo.load = 0.2
    bench.run(1.0)
    assert bench.servo.motor.position == 1000
    bench.servo.load = 2.0
    bench.run(1.0)
    assert bench.servo.motor.position < 900
