# SPDX-License-Identifier: Apache-2.0
"""What is wrong with a gait is said in the names and units of the fields, before the driver rejects it."""

import math

import pytest

from worm_driver.driver_errors import RejectedError
from worm_driver.gait.gait_limits import GaitLimits
from worm_msgs.gait import FORWARD, GAIT_DEFAULTS, REVERSE, Gait, Profile
from worm_optimizer.console.gait_fields import DEFAULTS, FIELDS, DriverLimits, edited, field_error

VALUES = {**DEFAULTS, "stroke": 0.07, "frequency": 0.2}
LIMITS = DriverLimits(0.09, 0.4, 0.12)


@pytest.mark.parametrize(
    ("name", "value", "facts"),
    [
        ("pretension", -0.003, ("pretension", "-3 mm")),
        ("stroke", 1.5, ("stroke", "1500 mm", "1000 mm")),
        ("stroke", 0.0, ("stroke", "0 mm", "more than 0")),
        ("frequency", math.nan, ("frequency",)),
        ("contraction_share", 1.2, ("contraction share", "1.2", "0.99")),
    ],
)
def test_a_wrong_value_is_named_as_its_field(name: str, value: float, facts: tuple[str, ...]):
    assert field_error(VALUES) == ""
    text = field_error({**VALUES, name: value})
    assert all(fact in text for fact in facts), text


@pytest.mark.parametrize("name", FIELDS)
def test_the_ranges_of_the_fields_are_those_of_a_gait(name: str):
    for value in (FIELDS[name].low, FIELDS[name].high):
        if not field_error({**VALUES, name: value}):
            Gait(**{**VALUES, name: value})


@pytest.mark.parametrize(
    ("changes", "facts"),
    [
        ({"stroke": 0.5}, ("500 mm", "90 mm")),
        ({"pretension": 0.03}, ("30 mm", "90 mm")),
        ({"frequency": 0.5}, ("0.5 Hz", "0.4 Hz")),
        ({"frequency": 0.4, "stroke": 0.09, "contraction_share": 0.2}, ("120 mm/s",)),
    ],
)
def test_the_driver_rejects_what_the_page_names_as_an_obstacle(changes, facts):
    assert LIMITS.obstacle(Gait(**VALUES)) == ""
    gait = Gait(**{**VALUES, **changes})
    text = LIMITS.obstacle(gait)
    assert all(fact in text for fact in facts), text
    with pytest.raises(RejectedError):
        GaitLimits(0.09, 0.4, 0.12).check(gait, 1)


def test_unchanged_fields_keep_all_digits_of_a_gait():
    exact = Gait(0.0712345678901, 0.2, FORWARD, margin=3.37e-3)
    gait = edited(exact, {"frequency": 0.21}, REVERSE, Profile.COSINE)
    assert (gait.stroke, gait.frequency, gait.margin) == (exact.stroke, 0.21, exact.margin)
    assert gait.direction == REVERSE
    entered = edited(None, VALUES, FORWARD, Profile.TRAPEZOID)
    assert entered.ramp_share == GAIT_DEFAULTS["ramp_share"]
