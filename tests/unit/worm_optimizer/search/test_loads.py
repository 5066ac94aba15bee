# SPDX-License-Identifier: Apache-2.0
"""Fronts, margins, scans and capability under loads, compared with direct evaluations and closed forms."""

import dataclasses
import math

import numpy as np
import pytest
from gaits_for_tests import QUICK, coarse_front

from worm_model.errors import InputError
from worm_model.gait import Gait
from worm_model.loads import content_under, under
from worm_model.parameters import PAPER, ParameterFile
from worm_model.simulation.closed_form import largest_load
from worm_model.simulation.simulator import evaluate_gait
from worm_msgs.conditions import Conditions
from worm_optimizer.evaluation.task import Bounds, MarginTask
from worm_optimizer.robustness.uncertainty import phase_known
from worm_optimizer.search.capability import capabilities, curve, strongest
from worm_optimizer.search.front import make_front

UPHILL = under(Conditions(slope_deg=20.0, tether_n=2.0), PAPER)


def test_forward_and_reverse_differ_under_a_load():
    """The load pushes a reverse gait."""
    forward, reverse = (coarse_front(MarginTask(UPHILL, way, 1e-3)).front for way in (1, -1))
    assert forward.power.min() != pytest.approx(reverse.power.min(), rel=1e-3)
    # in the mirror image, the front module is the rear one
    pushed = UPHILL.replace(rear_load=-UPHILL.front_load, front_load=-UPHILL.rear_load)
    mirrored = coarse_front(MarginTask(pushed, -1, 1e-3)).front
    assert mirrored.power.min() == pytest.approx(forward.power.min(), rel=1e-6)


def test_a_margin_may_be_stated_as_a_force():
    settings = dataclasses.replace(QUICK, margin_force=5.0)
    front = make_front(ParameterFile(), settings, 1)
    assert front.margin == pytest.approx(5.0 / (1833.1 + 442.0))


def test_conditions_of_the_settings_load_the_robot():
    settings = dataclasses.replace(QUICK, margin=1e-3, conditions=Conditions(slope_deg=20.0))
    front = make_front(ParameterFile(), settings, 1)
    weight = PAPER.rear_mass * 9.80665 * math.sin(math.radians(20.0))
    assert front.content.parameters.rear_load == pytest.approx(weight)
    level = make_front(ParameterFile(), dataclasses.replace(QUICK, margin=1e-3), 1)
    assert front.three["cruise"].cost_of_transport > level.three["cruise"].cost_of_transport


def test_an_interval_of_a_load_moves_with_the_conditions_and_is_drawn():
    content = ParameterFile(intervals={"rear_load": (-0.5, 0.5)})
    loaded = content_under(Conditions(tether_n=2.0), content)
    assert loaded.intervals["rear_load"] == pytest.approx((1.5, 2.5))
    drawn = phase_known(loaded, 2000, 1).overrides["rear_load"]
    assert np.mean(drawn) == pytest.approx(2.0, abs=0.02)
    assert np.mean((drawn > 1.5) & (drawn < 2.5)) == pytest.approx(0.95, abs=0.02)
    assert content_under(Conditions(), content) is content


def test_the_largest_load_is_where_a_gait_stops_to_move():
    task, gait = MarginTask(), Gait(0.0754, 0.147)
    (found,) = capabilities(task, [gait])
    step = 2e-4 * 2.0 * PAPER.engaged_stiffness * PAPER.switching_threshold
    for load, moves in ((found.largest_load - step, True), (found.largest_load + step, False)):
        result = evaluate_gait(gait, PAPER.replace(rear_load=load))
        assert (result.min_grooves > 0.9) == moves
    for slope, grooves in ((60.0, 2.0), (15.0, 2.0)):
        climbed = evaluate_gait(gait, under(Conditions(slope_deg=slope), PAPER))
        assert climbed.grooves_per_cycle == pytest.approx(grooves, abs=0.01)
    assert 60.0 < found.largest_slope_deg < 90.0
    assert found.full_load <= found.largest_load
    assert found.closed_form_largest_load == largest_load(gait, PAPER)


def test_no_gait_of_a_grid_carries_more_than_the_strongest():
    task = MarginTask(bounds=Bounds(frequency_low=0.1, frequency_high=0.2))
    best = strongest(task)
    (found,) = capabilities(task, [best])
    loaded = MarginTask(
        PAPER.replace(rear_load=1.01 * found.largest_load + 0.05), bounds=task.bounds
    )
    strokes, frequencies = np.meshgrid(np.linspace(0.01, 0.09, 161), np.linspace(0.1, 0.2, 5))
    assert not np.any(loaded.points(strokes.ravel(), frequencies.ravel()).count)
    points = curve(task, found.largest_load)
    costs = [point.cost_of_transport for point in points]
    assert points[0].load == 0.0
    assert costs[0] == np.nanmin(costs)


def test_gaits_that_do_not_move_carry_nothing():
    (found,) = capabilities(MarginTask(), [Gait(0.02, 0.2)])
    assert found.largest_load == found.largest_slope_deg == 0.0
    assert strongest(MarginTask(bounds=Bounds(0.01, 0.02))) is None


def test_a_load_that_the_fins_do_not_hold_is_the_reason():
    settings = dataclasses.replace(QUICK, margin=0.0, conditions=Conditions(tether_n=200.0))
    with pytest.raises(InputError, match="200 N; the fins hold up to"):
        make_front(ParameterFile(), settings, 1)
