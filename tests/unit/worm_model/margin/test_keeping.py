# SPDX-License-Identifier: Apache-2.0
"""Probability to keep the grooves, from the margins of a few cycles."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from random_cases import examples
from scipy.special import ndtr

from worm_model.margin.keeping import (
    MarginBelief,
    MarginModel,
    Probability,
    belief_of,
    keeps_probability,
)

SD = 0.0003  # m, of a measured margin


def belief(*margins: float) -> MarginBelief:
    """Return the posterior from successive cycles of two grooves."""
    count = len(margins)
    return belief_of(np.array(margins), np.full(count, SD), 0.0346 * np.arange(count))


def keeps(*margins: float) -> Probability:
    return keeps_probability(belief(*margins))


margins = st.lists(st.floats(-0.004, 0.012), min_size=2, max_size=12)


@given(margins)
def test_the_interval_contains_the_value(values):
    found = keeps(*values)
    assert 0.0 <= found.low <= found.value <= found.high <= 1.0


@given(margins, st.floats(1e-4, 5e-3))
def test_the_probability_grows_with_the_margins(values, more):
    before, after = keeps(*values), keeps(*(value + more for value in values))
    assert after.value >= before.value
    assert after.low >= before.low


@pytest.mark.parametrize("mean", [0.0005, 0.0015, 0.003])
def test_more_cycles_narrow_the_interval(mean):
    found = [keeps(*(mean + np.resize([-0.0005, 0.0005], n))) for n in (2, 4, 8, 32)]
    widths = [each.high - each.low for each in found]
    assert widths == sorted(widths, reverse=True)


def test_two_cycles_leave_the_probability_open():
    found = keeps(0.0012, 0.0008)
    assert found.low < 0.8
    assert found.high > 0.98


@examples(20)
@given(margins, margins)
def test_both_fins_keep_their_grooves_less_often_than_one(rear, front):
    fins = [belief(*each) for each in (rear, front)]
    both = keeps_probability(*fins).value
    one, other = (keeps_probability(fin).value for fin in fins)
    assert both == pytest.approx(one * other, abs=1e-9)


def test_the_interval_covers_the_true_probability():
    """Margins are drawn with a known mean and scatter, and a shared error of the instrument."""
    random = np.random.default_rng(1)
    inside = 0
    for _ in range(100):
        mean, scatter = random.uniform(0.0, 0.003), 0.0006 * np.exp(0.4 * random.standard_normal())
        shared = 0.0003 * random.standard_normal()
        drawn = mean + shared + scatter * random.standard_normal(5) + SD * random.standard_normal(5)
        found = keeps(*drawn)
        inside += found.low <= ndtr(mean / scatter) <= found.high
    assert inside >= 90


def test_a_linear_model_finds_the_slope_of_the_margin():
    random = np.random.default_rng(2)
    stroke = np.repeat([0.071, 0.073, 0.075], 5)
    margin = 0.001 + 0.8 * (stroke - 0.071) + 0.0004 * random.standard_normal(stroke.size)
    terms = np.stack([np.ones(stroke.size), stroke - 0.073], 1)
    place = 0.0346 * np.arange(stroke.size)
    model = MarginModel(
        margin, np.full(stroke.size, SD), place, terms, np.array([0.0, 0.8]), np.array([0.1, 0.3])
    )
    assert model.at([1.0, 0.004]).expected == pytest.approx(0.001 + 0.8 * 0.006, abs=0.0006)
