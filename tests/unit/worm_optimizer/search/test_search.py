# SPDX-License-Identifier: Apache-2.0
"""NSGA-II as an iterator, and its certificate."""

import itertools

import numpy as np
import pytest
from gaits_for_tests import COARSE_MAP

from worm_optimizer.search.certificate import MAP, NSGA2, certified_front
from worm_optimizer.search.gait_map import MapSettings
from worm_optimizer.search.nsga2 import SearchSettings, generations
from worm_optimizer.search.optimizer_errors import OptimizerError
from worm_optimizer.search.task import Bounds, MarginTask

TASK = MarginTask(margin=2e-3)
SMALL = SearchSettings(population=20, generations=8, seed=3)


def ignore(generation) -> None:
    """Who does not listen."""


def test_the_same_seed_gives_the_same_front_and_another_seed_another():
    ends = [
        list(generations(TASK, settings, 10.0))[-1].front
        for settings in (SMALL, SMALL, SearchSettings(20, 8, seed=4))
    ]
    assert np.array_equal(ends[0].stroke, ends[1].stroke)
    assert np.array_equal(ends[0].frequency, ends[1].frequency)
    assert not np.array_equal(ends[0].stroke, ends[2].stroke)


def test_every_generation_reports_and_the_front_only_grows():
    steps = list(generations(TASK, SMALL, 10.0))
    assert [step.number for step in steps] == list(range(1, 9))
    assert steps[-1].evaluations == pytest.approx(160, abs=10)
    areas = [step.hypervolume for step in steps]
    assert areas == sorted(areas)
    assert areas[-1] > areas[0] > 0.0


def test_nobody_forces_the_search_to_its_end():
    endless = generations(TASK, SearchSettings(population=10, generations=100_000), 10.0)
    assert [step.number for step in itertools.islice(endless, 3)] == [1, 2, 3]


def test_all_of_the_front_moves_within_the_bounds():
    front = list(generations(TASK, SMALL, 10.0))[-1].front
    assert np.all(front.branch >= 1)
    assert np.all((front.stroke >= 0.01) & (front.stroke <= 0.09))
    assert np.all((front.frequency >= 0.08) & (front.frequency <= 0.4))


@pytest.mark.parametrize("wrong", [{"population": 1}, {"generations": 0}, {"seed": -1}])
def test_settings_that_are_none_are_refused(wrong):
    with pytest.raises(OptimizerError, match="search:"):
        SearchSettings(**wrong)


@pytest.mark.parametrize("margin", [0.0, 3.4e-3, 5e-3])
def test_the_defaults_reach_the_required_share(margin):
    certified = certified_front(MarginTask(margin=margin), SearchSettings(), MapSettings(), ignore)
    assert 0.995 <= certified.hypervolume_share <= 1.002
    assert certified.missed_branches == ()
    assert certified.source == NSGA2


def test_a_search_that_falls_short_is_told_and_the_map_serves():
    reports = []
    certified = certified_front(
        TASK, SearchSettings(population=4, generations=1, seed=7), COARSE_MAP, reports.append
    )
    assert [report.number for report in reports] == [1]
    assert certified.hypervolume_share < 0.995
    assert certified.missed_branches == (2,)
    assert certified.source == MAP
    assert certified.front is certified.gait_map.front


def test_a_box_without_a_moving_gait_is_refused_with_a_remedy():
    task = MarginTask(bounds=Bounds(stroke_low=0.01, stroke_high=0.03))
    with pytest.raises(OptimizerError, match="allow longer strokes"):
        certified_front(task, SMALL, COARSE_MAP, ignore)
