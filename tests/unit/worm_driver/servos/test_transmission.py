# SPDX-License-Identifier: Apache-2.0
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from worm_driver.driver_errors import ConfigurationError, RejectedError
from worm_driver.servos.transmission import Fin, Spool

TICK = 2 * math.pi / 4096 * 0.025


@given(st.sampled_from([1, -1]), st.floats(-0.2, 0.2))
def test_a_length_comes_back_to_half_a_tick(sign, change):
    spool = Spool(1, sign, 0.025)
    assert spool.length_change(spool.ticks(change)) == pytest.approx(change, abs=TICK * 0.5001)


def test_one_turn_is_one_circumference():
    assert Spool(1, 1, 0.012).ticks(-2 * math.pi * 0.012) == 4096
    assert Spool(1, -1, 0.012).ticks(-2 * math.pi * 0.012) == -4096


@pytest.mark.parametrize("change", [math.nan, math.inf, -20.0])
def test_a_position_beyond_the_counter_is_rejected(change):
    with pytest.raises(RejectedError, match="cable servo 1"):
        Spool(1, 1, 0.012).ticks(change)


@pytest.mark.parametrize(
    ("sign", "radius"), [(0, 0.012), (2, 0.012), (1, 0.0), (1, 12.0), (1, math.nan)]
)
def test_an_impossible_spool_is_rejected(sign, radius):
    with pytest.raises(ConfigurationError, match="cable servo 1"):
        Spool(1, sign, radius)


def test_fins_turn_to_the_angle_of_their_direction():
    fin = Fin(11, math.pi / 2, 3 * math.pi / 2)
    assert (fin.ticks(1), fin.ticks(-1)) == (1024, 3072)
    with pytest.raises(ConfigurationError, match=r"fin servo 11 .* 7"):
        Fin(11, 0.0, 7.0)
