# SPDX-License-Identifier: Apache-2.0
"""Travel error of the next run, from few measured margins."""

import math

import numpy as np
import pytest

from worm_model.travel_error import PRIOR, travel_error
from worm_msgs.robot_parameters import TravelError


def test_without_a_measured_margin_it_is_the_prior() -> None:
    assert travel_error([], []) == PRIOR
    assert travel_error([math.nan], [0.003]) == PRIOR
    assert PRIOR.value == 0.0
    assert PRIOR.sd > 0.0


def test_one_run_shows_no_scatter() -> None:
    assert travel_error([0.001, math.nan], [0.003, 0.003]) == TravelError(-0.002, PRIOR.sd)


@pytest.mark.parametrize("runs", [2, 3, 5, 10])
def test_its_95_percent_contain_the_next_run(runs: int) -> None:
    rng = np.random.default_rng(runs)
    inside = 0
    for _ in range(2000):
        mean, scatter = rng.normal(0.0, 0.0015), rng.uniform(0.0002, 0.0008)
        *measured, following = mean + scatter * rng.standard_normal(runs + 1)
        error = travel_error(measured, np.zeros(runs))
        inside += abs(following - error.value) < 1.96 * error.sd
    assert 0.93 < inside / 2000 < 0.97


def test_a_small_scatter_of_two_runs_is_not_trusted() -> None:
    error = travel_error([0.0010, 0.0011], [0.002, 0.002])
    assert error.value == pytest.approx(-0.00095)
    assert error.sd > 5.0 * np.std([0.0010, 0.0011], ddof=1)


def test_two_contradictory_runs_are_no_worse_than_the_prior_and_their_scatter() -> None:
    error = travel_error([0.0, 0.002], [0.0, 0.0])
    assert error.sd == pytest.approx(math.hypot(PRIOR.sd, 0.002 / math.sqrt(2.0)))
