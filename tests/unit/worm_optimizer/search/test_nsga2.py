# SPDX-License-Identifier: Apache-2.0
"""NSGA-II, and its comparison with the exact front."""

import numpy as np
import pytest
from gaits_for_tests import coarse_front, random_robot

from worm_optimizer.evaluation.task import Bounds, MarginTask
from worm_optimizer.search.nsga2 import compared, hypervolume, nsga2_front
from worm_optimizer.search.search_settings import Nsga2Settings

TASK = MarginTask(margin=2e-3)
SMALL = Nsga2Settings(population=20, generations=8, seed=3)


def test_the_same_seed_gives_the_same_front_and_another_seed_another():
    ends = [
        nsga2_front(TASK, settings) for settings in (SMALL, SMALL, Nsga2Settings(20, 8, seed=4))
    ]
    assert np.array_equal(ends[0].stroke, ends[1].stroke)
    assert np.array_equal(ends[0].frequency, ends[1].frequency)
    assert not np.array_equal(ends[0].stroke, ends[2].stroke)


def test_more_generations_dominate_more():
    shares: list[float] = []
    last = nsga2_front(TASK, SMALL, shares.append)
    assert shares == [k / 8 for k in range(1, 9)]
    first = nsga2_front(TASK, Nsga2Settings(20, 1, seed=3))
    assert hypervolume(last, 10.0) > hypervolume(first, 10.0) > 0.0


def test_a_box_of_one_gait_has_this_gait():
    task = MarginTask(bounds=Bounds(0.0755, 0.0755, 0.15, 0.15))
    front = nsga2_front(task, SMALL)
    assert front.stroke.tolist() == [0.0755]
    assert front.frequency.tolist() == [0.15]


@pytest.mark.parametrize("seed", range(2))
def test_no_gait_of_nsga2_is_cheaper_than_the_exact_front(seed):
    exact = coarse_front(MarginTask(random_robot(seed)), frequencies=41)
    comparison = compared(exact, nsga2_front(exact.task, Nsga2Settings(30, 12, seed)))
    assert comparison.hypervolume_share <= 1.0
    assert comparison.largest_excess_power >= -1e-7


def test_a_search_that_falls_short_is_reported():
    exact = coarse_front(TASK)
    comparison = compared(exact, nsga2_front(TASK, Nsga2Settings(4, 1, seed=7)))
    assert comparison.hypervolume_share < 0.995
    assert comparison.missed_branches == (2.0,)
    assert comparison.largest_excess_power > 0.01
