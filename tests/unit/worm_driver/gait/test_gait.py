# SPDX-License-Identifier: Apache-2.0
import math
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from worm_driver.errors import LimitError
from worm_driver.gait.gait_limits import Gait, GaitLimits

LIMITS = GaitLimits(max_stroke=0.09, max_frequency=0.4, max_cable_speed=0.1)
GAITS = st.builds(Gait, st.floats(0.01, 0.09), st.floats(0.08, 0.4))


@given(GAITS, st.integers(0, 20))
def test_every_cycle_begins_and_ends_at_rest(gait, cycle):
    time = cycle / gait.frequency
    assert gait.length_change(time) == pytest.approx(0.0, abs=1e-12)
    after = (gait.length_change(time + 1e-6) - gait.length_change(time)) / 1e-6
    assert after == pytest.approx(0.0, abs=1e-6)


@given(GAITS, st.floats(0.0, 100.0))
def test_a_gait_contracts_by_its_stroke_and_never_extends(gait, time):
    assert -gait.stroke - 1e-12 <= gait.length_change(time) <= 0.0
    assert gait.length_change(0.5 / gait.frequency) == pytest.approx(-gait.stroke)


@given(GAITS, st.floats(0.0, 100.0))
def test_the_peak_speed_is_not_exceeded(gait, time):
    slope = (gait.length_change(time + 1e-5) - gait.length_change(time)) / 1e-5
    assert abs(slope) <= gait.peak_speed * (1 + 1e-6) + 1e-9


@pytest.mark.parametrize(
    ("gait", "cycles", "words"),
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
        (Gait(0.07, 0.1), 1000, "take 10000 s, a run at most 7200 s: ask for 720 cycles"),
        (Gait(0.07, 0.2), 0, "cycles must be 1 to"),
        (Gait(0.07, 0.2), 10**6, "cycles must be 1 to"),
        (Gait(0.09, 0.4), 5, "0.1131 m/s, the robot's limit is 0.1000"),
    ],
)
def test_what_the_robot_cannot_bear_is_refused_with_the_reason(gait, cycles, words):
    with pytest.raises(LimitError, match=re.escape(words)):
        LIMITS.check(gait, cycles)


def test_the_papers_gait_is_fine():
    LIMITS.check(Gait(0.07, 0.2), 5)
