# SPDX-License-Identifier: Apache-2.0
"""The price of robustness: its cliff by the written rule, and with the paper's parameters."""

import math

import pytest
from gaits_for_tests import COARSE_MAP

from worm_model.parameters import PAPER
from worm_model.simulation.closed_form import cliff_margin
from worm_optimizer.search.optimizer_errors import OptimizerError
from worm_optimizer.search.price_of_robustness import (
    MarginPoint,
    find_cliff,
    price_of_robustness,
    scan,
)
from worm_optimizer.search.search_settings import ScanSettings
from worm_optimizer.search.task import MarginTask


def point(margin: float, cost: float, branch: int, *branches: int) -> MarginPoint:
    return MarginPoint(margin, cost, 0.07, 0.2, branch, branches or (branch,), 0.01, 1.0)


STILL = MarginPoint(3e-3, math.nan, math.nan, math.nan, 0, (), math.nan, math.nan)


@pytest.mark.parametrize(
    ("initial_length", "expected"),
    [
        (0.2952, 3.4e-3),  # this project's calibration, which gives the paper's value
        (0.3000 - 0.0059, 2.5e-3),  # groove phase 0
    ],
)
def test_the_cliff_is_where_the_paper_and_the_closed_form_have_it(initial_length, expected):
    parameters = PAPER.replace(initial_length=initial_length)
    margins = ScanSettings(lowest=expected - 4e-4, highest=expected + 4e-4).margins()
    points = list(scan(MarginTask(parameters), COARSE_MAP, margins))
    price = price_of_robustness(points, parameters)
    assert price.cliff is not None
    assert price.cliff.margin == pytest.approx(expected, abs=1e-12)
    assert price.cliff.after == pytest.approx(expected + 1e-4, abs=1e-12)
    assert price.cliff.lost_branch == 2
    assert 1.8 < price.cliff.rise < 2.1
    assert price.closed_form_cliff_margin == cliff_margin(parameters)
    assert price.cliff.margin <= price.closed_form_cliff_margin <= price.cliff.after
    assert price.margin == price.cliff.margin


def test_a_dearer_optimum_on_a_kept_branch_is_no_cliff():
    assert find_cliff([point(0.0, 50.0, 2), point(1e-3, 80.0, 2)]) is None
    assert find_cliff([point(0.0, 50.0, 2), point(1e-3, 80.0, 1, 1, 2)]) is None


def test_a_lost_branch_that_costs_little_is_no_cliff():
    assert find_cliff([point(0.0, 52.5, 3), point(1e-3, 55.8, 2)]) is None


def test_the_first_dear_loss_is_the_cliff():
    points = [point(0.0, 52.0, 3), point(1e-3, 56.0, 2), point(2e-3, 112.0, 1), STILL]
    cliff = find_cliff(points)
    assert cliff is not None
    assert (cliff.margin, cliff.after, cliff.lost_branch) == (1e-3, 2e-3, 2)
    assert cliff.rise == pytest.approx(2.0)


def test_a_step_to_standing_still_is_a_cliff():
    cliff = find_cliff([point(0.0, 52.0, 1), point(2e-3, 56.0, 1), STILL])
    assert cliff is not None
    assert (cliff.margin, cliff.lost_branch) == (2e-3, 1)
    assert math.isinf(cliff.rise)


def test_without_a_cliff_the_greatest_moving_margin_is_chosen():
    assert price_of_robustness([point(0.0, 50.0, 2), point(1e-3, 51.0, 2)], PAPER).margin == 1e-3


def test_a_scan_in_which_nothing_moves_has_no_margin_to_choose():
    price = price_of_robustness([STILL], PAPER)
    with pytest.raises(OptimizerError, match="no gait within the bounds moves at any margin"):
        _ = price.margin


def test_the_default_margins_are_tenths_of_millimetres():
    margins = ScanSettings().margins()
    assert len(margins) == 81
    assert margins[34] == 0.0034
    assert margins[-1] == 0.008


@pytest.mark.parametrize(
    "wrong", [(1e-3, 0.0, 1e-4), (0.0, 1.0, 1e-4), (0.0, 8e-3, 0.0), (0, 8e-3, 1e-9)]
)
def test_margins_that_are_none_are_refused(wrong):
    with pytest.raises(OptimizerError, match="scan:"):
        ScanSettings(*wrong)
