# SPDX-License-Identifier: Apache-2.0
import itertools
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from worm_driver.servos.registers import COMMON, MODELS, XM430_W350, hardware_error_text
from worm_driver.servos.state_reader import STATE_SIZE, STATE_START
from worm_driver.virtual_robot.servo import control_table

POSITION = COMMON["present_position"]
MODEL_LIST = sorted(MODELS.values(), key=lambda model: model.number)


@pytest.mark.parametrize("model", MODEL_LIST, ids=lambda model: model.name)
def test_a_table_has_no_overlaps_no_gap_in_the_state_and_agrees_with_the_virtual_robots(model):
    """Two people read the manual: address, size and sign of every row of both tables are the same."""
    rows = sorted(model.registers.values(), key=lambda row: row.address)
    for before, after in itertools.pairwise(rows):
        assert before.end <= after.address, (before, after)
    state = [row for row in rows if 0 <= row.address - STATE_START < STATE_SIZE]
    assert (state[0].address, state[-1].end) == (STATE_START, STATE_START + STATE_SIZE)
    for before, after in itertools.pairwise(state):
        assert before.end == after.address
    for name, row in COMMON.items():
        assert model[name] == row
    other = next(m for m in control_table.MODELS.values() if m.number == model.number)
    for name, row in model.registers.items():
        found = other.registers[name]
        assert (row.address, row.size) == (found.address, found.size), name
        if row.signed != found.signed:
            assert name in {"goal_velocity", "goal_position"}, name


def test_hardware_errors_are_named():
    assert hardware_error_text(0b100001) == "input voltage, overload"
    assert hardware_error_text(0b100) == "overheating"
    assert hardware_error_text(0b10) == "unknown fault 0x02"


@given(st.integers(-(2**31), 2**31 - 1))
def test_a_signed_register_survives_its_bytes(raw):
    assert POSITION.unpack(POSITION.pack(raw)) == raw


def test_the_sdk_returns_minus_one_as_four_billion_and_this_does_not():
    assert POSITION.unpack(b"\xff\xff\xff\xff") == -1
    assert XM430_W350["present_current"].unpack(b"\xfe\xff") == -2
    assert COMMON["bus_watchdog"].unpack(b"\xff") == -1


def test_a_register_is_found_in_a_block():
    block = bytes(range(120, 147))
    assert COMMON["present_temperature"].unpack_from(block, 120) == 146
    assert COMMON["realtime_tick"].unpack_from(block, 120) == 120 | 121 << 8
    for name, start in (("torque_enable", 120), ("torque_enable", 65), ("present_temperature", 20)):
        with pytest.raises(ValueError, match=name):
            COMMON[name].unpack_from(block, start)


@given(st.floats(-1000.0, 1000.0))
def test_an_angle_comes_back_to_half_a_tick(angle):
    back = POSITION.from_raw(POSITION.to_raw(angle))
    assert back == pytest.approx(angle, abs=math.pi / 4096 * 1.0001)


def test_units_are_those_of_the_manual():
    assert COMMON["goal_position"].from_raw(4096) == pytest.approx(2 * math.pi)
    assert COMMON["velocity_limit"].from_raw(200) == pytest.approx(
        45.8 * 2 * math.pi / 60, rel=1e-3
    )
    assert XM430_W350["present_current"].from_raw(1000) == pytest.approx(2.69)
    assert COMMON["bus_watchdog"].from_raw(4) == pytest.approx(0.08)
    assert COMMON["return_delay_time"].from_raw(250) == pytest.approx(500e-6)


@pytest.mark.parametrize("value", [math.nan, math.inf, 1e9])
def test_a_missing_or_too_large_value_is_rejected(value):
    with pytest.raises(ValueError, match="goal_position"):
        COMMON["goal_position"].to_raw(value)
    with pytest.raises(ValueError, match="4 bytes, not 3"):
        POSITION.unpack(b"abc")
