# SPDX-License-Identifier: Apache-2.0
import itertools
import math
import re
from dataclasses import fields

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from worm_driver.errors import LimitError
from worm_driver.gait.gait_limits import COSINE, TRAPEZOID, Gait, GaitLimits
from worm_model import gait as model_gait
from worm_msgs.msg import Gait as GaitMessage

LIMITS = GaitLimits(max_stroke=0.09, max_frequency=0.4, max_cable_speed=0.1)
GAITS = st.builds(
    Gait,
    st.floats(0.01, 0.09),
    st.floats(0.08, 0.4),
    pretension=st.one_of(st.just(0.0), st.floats(0.0, 0.03)),
    contraction_share=st.one_of(st.just(0.5), st.floats(0.05, 0.95)),
    profile=st.sampled_from([COSINE, TRAPEZOID]),
    ramp_share=st.floats(0.1, 0.5),
)


@given(GAITS, st.integers(0, 20))
def test_every_cycle_begins_and_ends_at_its_point_of_rest(gait, cycle):
    time = cycle / gait.frequency
    assert gait.length_change(time) == pytest.approx(-gait.pretension, abs=1e-12)
    for after in (-1e-6, 1e-6):
        rate = (gait.length_change(time + after) - gait.length_change(time)) / after
        assert rate == pytest.approx(0.0, abs=1e-3)


@given(GAITS, st.floats(0.0, 100.0))
def test_a_gait_swings_between_its_pretension_and_its_reach(gait, time):
    assert -gait.reach - 1e-12 <= gait.length_change(time) <= -gait.pretension + 1e-12
    longest = gait.length_change(gait.contraction_share / gait.frequency)
    assert longest == pytest.approx(-gait.pretension - gait.stroke)


@given(GAITS, st.floats(0.0, 20.0))
def test_its_rate_is_continuous_and_never_above_the_peak_speed(gait, time):
    half = min(gait.contraction_share, 1.0 - gait.contraction_share) / gait.frequency
    step = 1e-5 * half
    change = [gait.length_change(time + k * step) for k in (-1, 0, 1)]
    rates = [(after - before) / step for before, after in itertools.pairwise(change)]
    assert max(map(abs, rates)) <= gait.peak_speed * (1 + 1e-6)
    # the steepest is a trapezoid's ramp, of a tenth of the half at least, or a cosine's turn
    assert abs(rates[1] - rates[0]) <= gait.peak_speed / (0.1 * half) * step * 1.1 + 1e-8


@given(GAITS)
def test_the_peak_speed_is_reached(gait):
    middles = (0.5 * gait.contraction_share, 0.5 * (1.0 + gait.contraction_share))
    step = 1e-5
    speeds = [
        abs(
            gait.length_change((m + step) / gait.frequency)
            - gait.length_change((m - step) / gait.frequency)
        )
        * gait.frequency
        / (2 * step)
        for m in middles
    ]
    assert max(speeds) == pytest.approx(gait.peak_speed, rel=1e-3)


@given(GAITS, st.lists(st.floats(0.0, 50.0), min_size=5, max_size=5))
def test_the_driver_plays_what_the_model_computes(gait, times):
    modelled = model_gait.gait_of(gait)
    assert modelled.peak_speed == pytest.approx(gait.peak_speed, rel=1e-12)
    played = [gait.length_change(time) for time in times]
    assert modelled.command(np.array(times)) == pytest.approx(played, rel=0.0, abs=1e-12)


@given(st.floats(0.01, 0.09), st.floats(0.08, 0.4), st.floats(0.0, 20.0))
def test_the_default_is_the_papers_gait(stroke, frequency, time):
    expected = -stroke / 2 * (1.0 - math.cos(2 * math.pi * frequency * time))
    assert Gait(stroke, frequency).length_change(time) == pytest.approx(expected, abs=1e-13)
    assert Gait(stroke, frequency).peak_speed == pytest.approx(math.pi * stroke * frequency)


def test_the_constants_are_those_of_the_message_and_of_the_model():
    assert (COSINE, TRAPEZOID) == (GaitMessage.COSINE, GaitMessage.TRAPEZOID)
    assert tuple(model_gait.Profile) == (COSINE, TRAPEZOID)
    assert {row.name: row.default for row in fields(Gait)} == {
        row.name: row.default for row in fields(model_gait.Gait)
    }


@pytest.mark.parametrize(
    ("gait", "cycles", "message"),
    [
        (Gait(math.nan, 0.2), 5, "stroke is nan"),
        (Gait(0.07, math.inf), 5, "frequency is inf"),
        (Gait(0.07, 0.2, 1, math.nan), 5, "margin is nan"),
        (Gait(0.0, 0.2), 5, "stroke 0 m is outside"),
        (Gait(0.0901, 0.2), 5, "limits.max_stroke_m"),
        (Gait(-0.07, 0.2), 5, "stroke -0.07"),
        (Gait(0.07, -0.2), 5, "frequency -0.2"),
        (Gait(0.01, 0.41), 5, "limits.max_frequency_hz"),
        (Gait(0.07, 0.2, 0), 5, "direction must be 1"),
        (Gait(0.07, 0.2, 1, -1e-3), 5, "margin -0.001 m is outside"),
        (Gait(0.07, 1e-300), 5, "frequency 1e-300 Hz is outside 0.02 to 0.4"),
        (Gait(1e-300, 0.2), 5, "stroke 1e-300 m is outside 0.001 to 0.09"),
        (Gait(0.07, 0.2, 1, 1e300), 5, "margin 1e+300 m is outside 0 to 0.09"),
        (Gait(0.07, 0.1), 1000, "take 10000 s; a run may take 7200 s: request at most 720 cycles"),
        (Gait(0.07, 0.2, pretension=math.nan), 5, "pretension is nan"),
        (Gait(0.07, 0.2, pretension=-1e-3), 5, "pretension -0.001 m is outside"),
        (Gait(0.07, 0.2, pretension=0.021), 5, "contract the body by 0.091 m; the limit is 0.09"),
        (Gait(0.07, 0.2, contraction_share=math.inf), 5, "contraction_share is inf"),
        (Gait(0.07, 0.2, contraction_share=0.0), 5, "contraction_share 0 is outside 0.01 to 0.99"),
        (Gait(0.07, 0.2, contraction_share=1.0), 5, "contraction_share 1 is outside 0.01 to 0.99"),
        (Gait(0.07, 0.2, contraction_share=0.2), 5, "0.1100 m/s; the limit is 0.1000"),
        (Gait(0.07, 0.2, contraction_share=0.8), 5, "frequency is at most 0.0127 m/s"),
        (Gait(0.07, 0.2, profile=2), 5, "profile must be 0 (cosine) or 1 (trapezoid), not 2"),
        (Gait(0.07, 0.2, ramp_share=0.0), 5, "ramp_share 0 is outside 0.1 to 0.5"),
        (Gait(0.07, 0.2, 1, 0.0, 0.0, 0.5, 1, math.nan), 5, "ramp_share is nan"),
        (Gait(0.08, 0.4, 1, 0.0, 0.0, 0.5, 1, 0.5), 5, "0.1280 m/s"),
        (Gait(0.07, 0.2), 0, "cycles must be 1 to"),
        (Gait(0.07, 0.2), 10**6, "cycles must be 1 to"),
        (Gait(0.09, 0.4), 5, "0.1131 m/s; the limit is 0.1000"),
    ],
)
def test_a_gait_beyond_the_limits_is_rejected_with_the_reason(gait, cycles, message):
    with pytest.raises(LimitError, match=re.escape(message)):
        LIMITS.check(gait, cycles)


@pytest.mark.parametrize(
    "gait",
    [
        Gait(0.07, 0.2),
        Gait(0.08, 0.2, pretension=0.01),
        Gait(0.09, 0.4, profile=TRAPEZOID, ramp_share=0.1),
    ],
)
def test_what_the_robot_can_play(gait):
    LIMITS.check(gait, 5)
