# SPDX-License-Identifier: Apache-2.0
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from worm_driver.servos.encoding import from_raw, pack, to_raw, unpack, unpack_from
from worm_driver.servos.registers import COMMON, XM430_W350

POSITION = COMMON["present_position"]


@given(st.integers(-(2**31), 2**31 - 1))
def test_a_signed_register_survives_its_bytes(raw):
    assert unpack(POSITION, pack(POSITION, raw)) == raw


def test_the_sdk_returns_minus_one_as_four_billion_and_this_does_not():
    assert unpack(POSITION, b"\xff\xff\xff\xff") == -1
    assert unpack(XM430_W350["present_current"], b"\xfe\xff") == -2


def test_an_expired_watchdog_reads_minus_one():
    assert unpack(COMMON["bus_watchdog"], b"\xff") == -1


def test_a_register_is_found_in_a_block():
    block = bytes(range(120, 147))
    assert unpack_from(COMMON["present_temperature"], block, 120) == 146
    assert unpack_from(COMMON["realtime_tick"], block, 120) == 120 | 121 << 8
    for name, start in (("torque_enable", 120), ("torque_enable", 65), ("present_temperature", 20)):
        with pytest.raises(ValueError, match=name):
            unpack_from(COMMON[name], block, start)


@given(st.floats(-1000.0, 1000.0))
def test_an_angle_comes_back_to_half_a_tick(angle):
    back = from_raw(POSITION, to_raw(POSITION, angle))
    assert back == pytest.approx(angle, abs=math.pi / 4096 * 1.0001)


def test_units_are_those_of_the_manual():
    assert from_raw(COMMON["goal_position"], 4096) == pytest.approx(2 * math.pi)
    assert from_raw(COMMON["velocity_limit"], 200) == pytest.approx(
        45.8 * 2 * math.pi / 60, rel=1e-3
    )
    assert from_raw(XM430_W350["present_current"], 1000) == pytest.approx(2.69)
    assert from_raw(COMMON["bus_watchdog"], 4) == pytest.approx(0.08)
    assert from_raw(COMMON["return_delay_time"], 250) == pytest.approx(500e-6)


@pytest.mark.parametrize("value", [math.nan, math.inf, 1e9])
def test_a_missing_or_too_large_value_is_rejected(value):
    with pytest.raises(ValueError, match="goal_position"):
        to_raw(COMMON["goal_position"], value)


def test_a_wrong_number_of_bytes_is_rejected():
    with pytest.raises(ValueError, match="4 bytes, not 3"):
        unpack(POSITION, b"abc")
