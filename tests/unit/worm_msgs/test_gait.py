# SPDX-License-Identifier: Apache-2.0
"""The command u_cmd of a gait, in numbers and in arrays."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from worm_msgs.gait import FORWARD, GAIT_UNITS, REVERSE, Gait, GaitError, Profile, gait_of
from worm_msgs.msg import Gait as GaitMessage

GAITS = st.builds(
    Gait,
    st.floats(0.01, 0.09),
    st.floats(0.08, 0.4),
    pretension=st.one_of(st.just(0.0), st.floats(0.0, 0.03)),
    contraction_share=st.one_of(st.just(0.5), st.floats(0.05, 0.95)),
    profile=st.sampled_from([Profile.COSINE, Profile.TRAPEZOID]),
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
def test_the_command_of_an_array_is_that_of_its_times(gait, times):
    played = [gait.length_change(time) for time in times]
    assert gait.command(np.array(times)) == pytest.approx(played, rel=0.0, abs=1e-16)


@given(st.floats(0.01, 0.09), st.floats(0.08, 0.4), st.floats(0.0, 20.0))
def test_the_default_is_the_papers_gait(stroke, frequency, time):
    expected = -stroke / 2 * (1.0 - math.cos(2 * math.pi * frequency * time))
    assert Gait(stroke, frequency).length_change(time) == pytest.approx(expected, abs=1e-13)
    assert Gait(stroke, frequency).peak_speed == pytest.approx(math.pi * stroke * frequency)


@pytest.mark.parametrize(
    ("changes", "facts"),
    [
        ({"stroke": "wide"}, ["stroke", "'wide'"]),
        ({"frequency": None}, ["frequency", "None"]),
        ({"margin": [0.001]}, ["margin", "[0.001]"]),
        ({"stroke": 10**400}, ["stroke"]),
        ({"stroke": 0.0}, ["stroke"]),
        ({"stroke": 70.0}, ["stroke", "70"]),
        ({"frequency": math.nan}, ["frequency", "nan"]),
        ({"margin": -0.001}, ["margin", "-0.001"]),
        ({"direction": 0}, ["direction", "0"]),
        ({"pretension": -1e-3}, ["pretension", "-0.001"]),
        ({"contraction_share": 1.0}, ["contraction_share", "1"]),
        ({"profile": "sawtooth"}, ["profile", "sawtooth"]),
        ({"profile": 0.5}, ["profile", "0.5"]),
        ({"ramp_share": 0.51}, ["ramp_share", "0.51"]),
        ({"direction": 1.7}, ["direction", "1.7"]),
        ({"direction": math.nan}, ["direction", "nan"]),
        ({"direction": "forward"}, ["direction", "forward"]),
    ],
)
def test_an_inadmissible_value_is_named_with_its_field(changes, facts):
    with pytest.raises(GaitError) as error:
        gait_of({"stroke": 0.07, "frequency": 0.2} | changes)
    assert [fact for fact in facts if fact not in str(error.value)] == []


@pytest.mark.parametrize("name", ["stroke", "frequency"])
def test_a_gait_without_a_mandatory_field_is_rejected(name):
    source = {"stroke": 0.07, "frequency": 0.2}
    del source[name]
    with pytest.raises(GaitError, match=name):
        gait_of(source)


def test_a_direction_is_an_integer():
    assert type(gait_of({"stroke": 0.07, "frequency": 0.2, "direction": -1.0}).direction) is int


def test_the_fields_and_constants_are_those_of_the_message():
    assert list(GaitMessage.get_fields_and_field_types()) == list(GAIT_UNITS)
    assert (Profile.COSINE, Profile.TRAPEZOID) == (GaitMessage.COSINE, GaitMessage.TRAPEZOID)
    assert (FORWARD, REVERSE) == (GaitMessage.FORWARD, GaitMessage.REVERSE)
