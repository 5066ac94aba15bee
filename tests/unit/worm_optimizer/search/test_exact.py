# SPDX-License-Identifier: Apache-2.0
"""The exact front, compared with dense grids of gaits, with the closed form, and with finer scans of single edges."""

import dataclasses
import math

import numpy as np
import pytest
from gaits_for_tests import COARSE, coarse_front, random_robot
from hypothesis import given, settings
from hypothesis import strategies as st

from worm_model.gait import Gait
from worm_model.parameters import PAPER
from worm_model.simulation.actuation import length_change_range
from worm_model.simulation.closed_form import grooves_per_cycle
from worm_model.simulation.simulator import evaluate_gait
from worm_optimizer.evaluation.actuator_limits import ActuatorLimits
from worm_optimizer.evaluation.task import EDGE_ALLOWANCE, Bounds, MarginTask, Points
from worm_optimizer.optimizer_errors import OptimizerError
from worm_optimizer.search.exact import Resolution, Zoom, exact_front, transport_cost

ACCEPTED = 2e-5  # relative excess of power over a gait of a dense grid


def dense_grid(task: MarginTask, frequencies: np.ndarray, strokes: int = 401) -> Points:
    """Return the admissible gaits of a grid over a task's box, at frequencies in Hz."""
    box = task.bounds
    grid = np.meshgrid(np.linspace(box.stroke_low, box.stroke_high, strokes), frequencies)
    points = task.points(*(axis.ravel() for axis in grid))
    return points.take(points.admissible)


def excess(front: Points, others: Points) -> float:
    """Return the largest relative excess of the front's lowest power over the power of gaits that are no faster."""
    reached, wanted = (points.count * points.frequency for points in (front, others))
    place = np.searchsorted(reached, wanted * (1.0 - 1e-9))
    return float(np.max(np.append(front.power, np.inf)[place] / others.power, initial=0.0) - 1.0)


@pytest.mark.parametrize(("margin", "cost"), [(0.0, 55.281), (3.4e-3, 61.5015)])
def test_the_papers_robot_is_as_good_as_the_best_that_is_known(margin, cost):
    task = MarginTask(margin=margin)
    exact = exact_front(task, Resolution(), Zoom())
    best = transport_cost(exact.front).min() / (PAPER.mass * 9.80665)
    assert best <= cost
    grid = dense_grid(task, np.linspace(0.08, 0.4, 161))
    assert excess(exact.front, grid) < ACCEPTED
    assert exact.power_rises


@settings(max_examples=8, deadline=None)
@given(st.integers(0, 10_000), st.sampled_from([0.0, 1e-3, 2.5e-3]), st.sampled_from([1, -1]))
def test_no_gait_of_a_dense_grid_is_cheaper(seed, margin, direction):
    task = MarginTask(random_robot(seed), direction, margin)
    exact = exact_front(task, Resolution(41, 21), Zoom())
    grid = dense_grid(task, np.linspace(0.08, 0.4, 21), 801)
    assert bool(len(exact.front)) == bool(len(grid)) or not len(grid)
    assert excess(exact.front, grid) < ACCEPTED


@settings(max_examples=5, deadline=None)
@given(
    st.integers(0, 10_000),
    st.floats(20.0, 120.0),
    st.floats(3.0, 30.0),
    st.floats(0.02, 0.12),
)
def test_no_gait_of_a_dense_grid_within_the_limits_is_cheaper(seed, force, power, speed):
    limits = ActuatorLimits(speed, force, power, stall_force=1.5 * force, no_load_speed=3.0 * speed)
    task = MarginTask(random_robot(seed), limits=limits)
    exact = exact_front(task, Resolution(41, 9), Zoom())
    assert np.all(exact.front.violation <= 0.0)
    assert excess(exact.front, dense_grid(task, np.linspace(0.08, 0.4, 9), 201)) < ACCEPTED


def test_every_gait_gains_its_grooves_when_it_is_evaluated_again():
    task = MarginTask(margin=3.4e-3)
    front = coarse_front(task).front
    for row in range(len(front)):
        gait = Gait(float(front.stroke[row]), float(front.frequency[row]), 1, 3.4e-3)
        again = evaluate_gait(gait)
        assert again.min_grooves >= 1.0 - 1e-3
        assert again.grooves_per_cycle == pytest.approx(front.grooves[row], abs=1e-3)
        assert again.power == pytest.approx(front.power[row], rel=1e-12)


def test_an_edge_is_the_shortest_stroke_but_for_the_stated_allowance():
    task = MarginTask()
    edges = task.edges(np.array([0.15, 0.3]), np.tile(np.linspace(0.01, 0.09, 21), (2, 1)))
    shorter = edges.points.stroke - 3.0 * EDGE_ALLOWANCE
    assert np.all(task.points(shorter, edges.points.frequency).count < edges.points.count)
    assert edges.points.count.tolist() == [3, 6, 3, 6]


@given(st.integers(0, 10_000))
@settings(max_examples=5, deadline=None)
def test_in_the_slow_limit_the_edges_are_those_of_the_closed_form(seed):
    """With little friction the module whose fins hold does not move, and counting needs no simulation."""
    slow = 0.01  # Hz
    robot = random_robot(seed).replace(viscous_friction=5.0)
    edges = MarginTask(robot, bounds=Bounds(0.01, 0.2, slow, slow)).edges(
        np.array([slow]), np.linspace(0.01, 0.2, 96)[np.newaxis]
    )
    for stroke, count in zip(edges.points.stroke, edges.points.count // 3, strict=True):
        low, high = (Gait(stroke + by, slow) for by in (-2e-4, 2e-4))
        assert grooves_per_cycle(low, robot) <= count <= grooves_per_cycle(high, robot)
        assert length_change_range(low, robot)[1] <= 0.0


def test_a_speed_is_answered_between_the_columns():
    exact = exact_front(MarginTask(margin=3.4e-3), Resolution(), Zoom())
    for speed in (0.0015, 0.004, 0.00567, 0.008):
        gait = exact.cheapest(
            lambda points, v=speed: np.where(points.speed >= v, points.power, np.inf)
        )
        assert speed <= gait.speed[0] <= speed + 1e-7 or gait.power[0] < 1.3
        finer = dense_grid(exact.task, np.linspace(0.08, 0.4, 41))
        assert gait.power[0] <= finer.power[finer.speed >= speed].min() * (1.0 + ACCEPTED)


def test_the_end_of_a_branch_between_two_columns_is_reached():
    exact = coarse_front(MarginTask(margin=3.4e-3))
    assert exact.front.speed[-1] == pytest.approx(0.0081197, rel=1e-4)


def test_a_single_stroke_or_frequency_is_a_box():
    single = exact_front(MarginTask(bounds=Bounds(0.07, 0.07, 0.1, 0.3)), COARSE, Zoom())
    assert set(single.front.stroke.tolist()) == {0.07}
    assert len(single.front) > 1
    tiny = exact_front(MarginTask(bounds=Bounds(0.01, 0.09, 0.2, 0.2)), COARSE, Zoom())
    assert tiny.front.grooves.tolist() == [1.0, 2.0]
    assert (
        exact_front(
            MarginTask(bounds=Bounds(0.03, 0.03, 0.2, 0.2)), COARSE, Zoom()
        ).front.stroke.tolist()
        == []
    )


def test_strokes_that_the_body_cannot_make_are_no_box():
    with pytest.raises(OptimizerError, match=r"stroke up to 0.5 m; the body is 0.2952 m long"):
        MarginTask(bounds=Bounds(stroke_high=0.5))


def test_a_power_below_the_idle_power_is_no_limit():
    with pytest.raises(OptimizerError, match=r"electrical_power = 0.5 W .* idle power of 0.82 W"):
        MarginTask(limits=ActuatorLimits(electrical_power=0.5))


@pytest.mark.parametrize("wrong", [(2, 17), (21, 1)])
def test_a_resolution_that_is_none_is_rejected(wrong):
    with pytest.raises(OptimizerError, match="resolution:"):
        Resolution(*wrong)


def test_what_was_verified_is_stated():
    stated = coarse_front(MarginTask()).verification
    assert (stated["strokes"], stated["frequencies"]) == (21, 17)
    assert stated["stroke_step"] == pytest.approx(4e-3)
    assert stated["counts_verified"] == len(coarse_front(MarginTask()).front)
    assert math.isclose(stated["edge_allowance"], EDGE_ALLOWANCE)


def test_unequal_modules_have_a_front_in_each_direction():
    robot = PAPER.replace(front_mass=0.9)
    fronts = [coarse_front(MarginTask(robot, way, 1e-3)).front for way in (1, -1)]
    equal = [coarse_front(MarginTask(PAPER, way, 1e-3)).front for way in (1, -1)]
    assert not np.allclose(fronts[0].power[0], fronts[1].power[0], rtol=1e-6)
    assert np.allclose(equal[0].power[0], equal[1].power[0], rtol=1e-6)
    assert dataclasses.astuple(equal[0])[4].tolist() == dataclasses.astuple(equal[1])[4].tolist()
