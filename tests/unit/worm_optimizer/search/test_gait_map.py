# SPDX-License-Identifier: Apache-2.0
"""The exhaustive map finds the borders, all branches, and so the true front."""

import numpy as np
import pytest
from gaits_for_tests import COARSE_MAP

from worm_optimizer.search.gait_map import MapSettings, borders_of, build_map
from worm_optimizer.search.optimizer_errors import OptimizerError
from worm_optimizer.search.pareto import hypervolume
from worm_optimizer.search.task import Bounds, MarginTask


def test_just_below_a_border_the_branch_is_another():
    task = MarginTask(margin=2e-3)
    borders = borders_of(build_map(task, COARSE_MAP).points)
    assert borders.branch == (1, 2)
    for branch, stroke in zip(borders.branch, borders.stroke, strict=True):
        at = task.grooves(stroke, borders.frequency)
        below = task.grooves(stroke - 1.5e-4, borders.frequency)
        assert np.all(at == branch)
        assert np.all(below < branch)


def test_the_front_lies_on_the_borders():
    task = MarginTask(margin=2e-3)
    front = build_map(task, COARSE_MAP).front
    below = task.grooves(front.stroke - 3e-4, front.frequency)
    assert np.all(below < front.branch)


def test_a_random_search_of_the_box_betters_nothing():
    task = MarginTask(margin=3.4e-3)
    front = build_map(task, MapSettings()).front
    rng = np.random.default_rng(1)
    tried = task.points(rng.uniform(0.01, 0.09, 4000), rng.uniform(0.08, 0.4, 4000))
    reachable = np.interp(tried.power, front.power, front.speed, left=0.0)
    # Between two gaits of the front, a true one may be better by the map's resolution.
    assert np.all(tried.speed[tried.admissible] <= 1.005 * reachable[tried.admissible])


def test_a_finer_map_is_hardly_better():
    task = MarginTask(margin=3.4e-3)
    fronts = [build_map(task, MapSettings(followed=count)).front for count in (7, 15)]
    power = 1.1 * fronts[1].power.max()
    areas = [hypervolume(front, power) for front in fronts]
    assert areas[0] == pytest.approx(areas[1], rel=2e-3)
    assert areas[0] <= areas[1] * (1.0 + 1e-6)


def test_the_tip_of_a_branch_is_found():
    """At 3.4 mm two grooves end in a tip at about 0.235 Hz, thinner than a cell of the grid."""
    front = build_map(MarginTask(margin=3.4e-3), COARSE_MAP).front
    assert front.speed.max() == pytest.approx(0.00812, rel=5e-3)
    assert front.branch[-1] == 2


def test_reverse_is_the_mirror_image():
    fronts = [
        build_map(MarginTask(margin=2e-3, direction=way), COARSE_MAP).front for way in (1, -1)
    ]
    assert fronts[0].speed == pytest.approx(fronts[1].speed, rel=1e-6)
    assert fronts[0].power == pytest.approx(fronts[1].power, rel=1e-6)


def test_where_nothing_moves_the_front_is_empty():
    short = Bounds(stroke_low=0.01, stroke_high=0.03)
    gait_map = build_map(MarginTask(bounds=short), COARSE_MAP)
    assert len(gait_map.front) == 0
    assert gait_map.branches == ()


@pytest.mark.parametrize("wrong", [{"strokes": 2}, {"frequencies": 1}, {"tolerance": 0.0}])
def test_a_resolution_that_is_none_is_refused(wrong):
    with pytest.raises(OptimizerError, match="map:"):
        MapSettings(**wrong)
