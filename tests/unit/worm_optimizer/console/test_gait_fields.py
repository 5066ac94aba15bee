# SPDX-License-Identifier: Apache-2.0
"""What is wrong with a gait is said in the names and units of the fields, before the driver rejects it."""

import math
import re
from contextlib import nullcontext

import pytest

from worm_driver.driver_errors import RejectedError
from worm_driver.gait.gait_limits import GaitLimits
from worm_msgs.gait import Gait
from worm_optimizer.console.gait_fields import FIELDS, field_error, rejection

SHOWN = {
    "stroke": 70.0,
    "frequency": 0.2,
    "margin": 3.0,
    "pretension": 0.0,
    "contraction_share": 0.5,
    "ramp_share": 0.25,
}
LIMITS = (0.09, 0.4, 0.12)


def gait_of(**shown: float) -> Gait:
    return Gait(**{name: value / FIELDS[name].scale for name, value in (SHOWN | shown).items()})


@pytest.mark.parametrize(
    ("name", "value", "text"),
    [
        ("pretension", -3.0, "pretension, mm: enter a number from 0 to 1000"),
        ("stroke", 1500.0, "stroke, mm: enter a number from 1 to 1000"),
        ("stroke", 0.0, "stroke, mm: enter a number from 1 to 1000"),
        ("frequency", math.nan, "frequency, Hz: enter a number from 0.02 to 20"),
        ("contraction_share", 1.2, "contraction share: enter a number from 0.01 to 0.99"),
    ],
)
def test_a_wrong_value_is_named_as_its_field(name: str, value: float, text: str):
    assert field_error(SHOWN) == ""
    assert field_error(SHOWN | {name: value}) == text


@pytest.mark.parametrize("name", FIELDS)
def test_the_ranges_of_the_fields_are_those_of_a_gait(name: str):
    for value in FIELDS[name][2:]:
        assert field_error(SHOWN | {name: value}) == ""
        gait_of(**{name: value})


@pytest.mark.parametrize(
    ("shown", "text"),
    [
        ({"stroke": 500.0}, "stroke plus pretension, mm: 500 is more .* 90"),
        ({"pretension": 30.0}, "stroke plus pretension, mm: 100 is more .* 90"),
        ({"frequency": 0.5}, "frequency, Hz: 0.5 is more .* 0.4"),
        ({"frequency": 0.4, "contraction_share": 0.2}, "speed of the cable, mm/s: .* 120"),
        ({"stroke": FIELDS["stroke"].low, "frequency": FIELDS["frequency"].low}, ""),
        ({"pretension": 20.0}, ""),  # 0.02 + 0.07 exceeds 0.09 in floating point
    ],
)
def test_the_page_names_what_the_driver_rejects(shown: dict[str, float], text: str):
    gait = gait_of(**shown)
    assert re.fullmatch(text, rejection(gait, LIMITS))
    with pytest.raises(RejectedError) if text else nullcontext():
        GaitLimits(*LIMITS).check(gait, 1)
