# SPDX-License-Identifier: Apache-2.0
"""The price of robustness: its cliff by the documented rule, and with the paper's parameters."""

import math

import numpy as np
import pytest
from gaits_for_tests import random_robot

from worm_model.errors import InputError
from worm_model.parameters import PAPER
from worm_model.simulation.closed_form import cliff_margin
from worm_optimizer.evaluation.task import Bounds, MarginTask
from worm_optimizer.search.exact import Resolution, Zoom, exact_front, transport_cost
from worm_optimizer.search.price_of_robustness import (
    CLIFF_TOLERANCE,
    MarginPoint,
    PriceOfRobustness,
    find_cliff,
    price_of_robustness,
    scan,
)
from worm_optimizer.search.search_settings import ScanSettings

TASK = MarginTask()


def point(margin: float, cost: float, branch: float, *branches: float) -> MarginPoint:
    return MarginPoint(margin, cost, 0.07, 0.2, branch, branches or (branch,))


STILL = MarginPoint(3e-3, math.nan, math.nan, math.nan, 0.0, ())


@pytest.mark.parametrize(
    ("initial_length", "before"),
    [
        (0.2952, 3.4e-3),  # this project's calibration, which reproduces the paper's value
        (0.3000 - 0.0059, 2.5e-3),  # groove phase 0
    ],
)
def test_the_cliff_is_where_the_paper_and_the_closed_form_have_it(initial_length, before):
    parameters = PAPER.replace(initial_length=initial_length)
    margins = ScanSettings(lowest=before - 4e-4, highest=before + 4e-4).margins()
    price = price_of_robustness(MarginTask(parameters), margins)
    assert price.cliff is not None
    assert price.cliff.before == pytest.approx(before, abs=1e-12)
    assert price.cliff.after == pytest.approx(before + 1e-4, abs=1e-12)
    assert price.cliff.before <= price.cliff.margin <= price.cliff.after
    assert price.cliff.lost_branch == 2
    assert 1.8 < price.cliff.rise < 2.1
    assert price.closed_form_cliff_margin == cliff_margin(parameters)
    assert price.cliff.margin == pytest.approx(price.closed_form_cliff_margin, abs=2e-6)
    assert price.margin == price.cliff.before


def test_the_branch_is_there_at_the_cliff_and_lost_a_micrometre_beyond():
    price = price_of_robustness(TASK, np.array([3.0e-3, 3.5e-3]))
    at, beyond = scan(TASK, price.cliff.margin + np.array([0.0, CLIFF_TOLERANCE]))
    assert at.branch == 2
    assert 2 not in beyond.branches


@pytest.mark.parametrize(("seed", "margin"), [(None, 0.0), (None, 3.4e-3), (3, 1e-3), (11, 0.0)])
def test_the_lowest_cost_is_that_of_the_exact_front(seed, margin):
    task = MarginTask(PAPER if seed is None else random_robot(seed))
    (found,) = scan(task, np.array([margin]))
    front = exact_front(task.with_margin(margin), Resolution(), Zoom()).front
    best = transport_cost(front).min() / (task.parameters.mass * 9.80665)
    assert found.cost_of_transport == pytest.approx(best, rel=2e-5)


def test_no_cliff_is_a_dearer_optimum_on_a_kept_branch_nor_a_lost_branch_that_costs_little():
    assert find_cliff(TASK, [point(0.0, 50.0, 2), point(1e-3, 80.0, 2)]) is None
    assert find_cliff(TASK, [point(0.0, 50.0, 2), point(1e-3, 80.0, 1, 1, 2)]) is None
    assert find_cliff(TASK, [point(0.0, 52.5, 3), point(1e-3, 55.8, 2)]) is None


def test_the_first_dear_loss_is_the_cliff():
    points = [point(0.0, 52.0, 3), point(1e-3, 56.0, 2), point(2e-3, 112.0, 1), STILL]
    cliff = find_cliff(TASK, points)
    assert cliff is not None
    assert (cliff.before, cliff.after, cliff.lost_branch) == (1e-3, 2e-3, 2)
    assert cliff.rise == pytest.approx(2.0)


def test_a_step_to_standing_still_is_a_cliff():
    short = MarginTask(bounds=Bounds(stroke_high=0.055))
    price = price_of_robustness(short, np.array([0.0, 2e-3, 4e-3, 6e-3]))
    assert price.cliff is not None
    assert price.cliff.lost_branch == 1
    assert math.isinf(price.cliff.rise)
    assert (scan(short, np.array([price.cliff.margin]))[0].branch) == 1


def test_without_a_cliff_the_greatest_moving_margin_is_chosen_if_there_is_one():
    moving = (point(0.0, 50.0, 2), point(1e-3, 51.0, 2))
    assert PriceOfRobustness(moving, None, 3.4e-3, 1.1e-3).margin == 1e-3
    with pytest.raises(InputError, match="no gait within the bounds moves at any margin"):
        _ = PriceOfRobustness((STILL,), None, 3.4e-3, 1.1e-3).margin
