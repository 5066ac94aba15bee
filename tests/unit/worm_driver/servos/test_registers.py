# SPDX-License-Identifier: Apache-2.0
import itertools
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from worm_driver.servos.registers import COMMON, MODELS, XM430_W350, hardware_error_text
from worm_driver.servos.state_reader import STATE_SIZE, STATE_START

POSITION = COMMON["present_position"]
MODEL_LIST = sorted(MODELS.values(), key=lambda model: model.number)


#: Name, address and size (s: signed) of the registers of every model, copied from the e-manual by another person.
MANUAL = """
    model_number 0 2, firmware_version 6 1, id 7 1, baud_rate 8 1, return_delay_time 9 1, drive_mode 10 1,
    operating_mode 11 1, secondary_id 12 1, homing_offset 20 4s, temperature_limit 31 1,
    max_voltage_limit 32 2, min_voltage_limit 34 2, pwm_limit 36 2, velocity_limit 44 4,
    max_position_limit 48 4, min_position_limit 52 4, startup_configuration 60 1, shutdown 63 1,
    torque_enable 64 1, led 65 1, status_return_level 68 1, hardware_error_status 70 1,
    velocity_i_gain 76 2, position_d_gain 80 2, position_i_gain 82 2, position_p_gain 84 2,
    feedforward_2nd_gain 88 2, feedforward_1st_gain 90 2, bus_watchdog 98 1s, goal_pwm 100 2s,
    goal_velocity 104 4s, profile_acceleration 108 4, profile_velocity 112 4, goal_position 116 4s,
    realtime_tick 120 2, moving 122 1, moving_status 123 1, present_pwm 124 2s, present_velocity 128 4s,
    present_position 132 4s, velocity_trajectory 136 4s, position_trajectory 140 4s,
    present_input_voltage 144 2, present_temperature 146 1
"""


def test_the_common_registers_are_the_manuals():
    found = [f"{r.name} {r.address} {r.size}{'s' * r.signed}" for r in COMMON.values()]
    assert found == " ".join(MANUAL.split()).split(", ")


@pytest.mark.parametrize("model", MODEL_LIST, ids=lambda model: model.name)
def test_the_registers_of_current_and_load_are_the_manuals(model):
    rows = (row for name, row in model.registers.items() if name not in COMMON)
    currents = {"current_limit 38 2", "goal_current 102 2s", "present_current 126 2s"}
    assert {f"{r.name} {r.address} {r.size}{'s' * r.signed}" for r in rows} == (
        currents if model.measures_current else {"present_load 126 2s"}
    )


@pytest.mark.parametrize("model", MODEL_LIST, ids=lambda model: model.name)
def test_a_table_has_no_overlaps_and_no_gap_in_the_state(model):
    rows = sorted(model.registers.values(), key=lambda row: row.address)
    for before, after in itertools.pairwise(rows):
        assert before.end <= after.address, (before, after)
    state = [row for row in rows if 0 <= row.address - STATE_START < STATE_SIZE]
    assert (state[0].address, state[-1].end) == (STATE_START, STATE_START + STATE_SIZE)
    for before, after in itertools.pairwise(state):
        assert before.end == after.address
    for name, row in COMMON.items():
        assert model[name] == row


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
