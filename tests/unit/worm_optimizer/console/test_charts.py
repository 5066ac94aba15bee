# SPDX-License-Identifier: Apache-2.0
"""Axes have round numbers, points lie where their values are, and gaps interrupt lines."""

import math
import re

import pytest

from worm_optimizer.console.charts import Axis, axis_of, dots, lines

X = Axis("time, s", -60.0, 0.0, (-60.0, 0.0))
Y = Axis("power, W", 0.0, 4.0, (0.0, 4.0))


@pytest.mark.parametrize(
    ("values", "ticks"),
    [
        ([0.6, 8.1], (0.0, 2.0, 4.0, 6.0, 8.0, 10.0)),
        ([219.0, 296.0, math.nan], (200.0, 220.0, 240.0, 260.0, 280.0, 300.0)),
        ([2.5, 2.5], (2.5, 2.501)),
        ([], (0.0, 0.5, 1.0)),
    ],
)
def test_axes_begin_and_end_at_round_numbers(values: list[float], ticks: tuple[float, ...]):
    axis = axis_of("", values)
    assert (axis.low, axis.high) == (axis.ticks[0], axis.ticks[-1])
    assert all(axis.low <= value <= axis.high for value in values if math.isfinite(value))
    if values:
        assert axis.ticks == pytest.approx(ticks)


def test_lines_are_interrupted_where_there_is_no_value():
    drawn = lines(X, Y, [("measured", [(-60.0, 0.0), (-30.0, 4.0), (-20.0, math.nan), (0.0, 2.0)])])
    (path,) = re.findall(r'class="curve measured" d="([^"]*)"', drawn)
    assert path == "M0 1000L500 0M1000 500"


def test_the_chosen_point_is_marked_a_second_time():
    points = [(-60.0, 0.0), (-30.0, 4.0)]
    assert dots(X, Y, points, None).count("M500 0h0") == 1
    assert dots(X, Y, points, 1).count("M500 0h0") == 2
