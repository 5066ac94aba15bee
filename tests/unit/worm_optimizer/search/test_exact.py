# SPDX-License-Identifier: Apache-2.0
"""The exact front, compared with dense grids of gaits, with the closed form, and with finer scans of single edges."""

import numpy as np
import pytest
from gaits_for_tests import random_robot
from hypothesis import given
from hypothesis import strategies as st
from random_cases import examples

from worm_model.gait import Gait
from worm_model.parameters import PAPER
from worm_model.simulation.actuation import length_change_range
from worm_model.simulation.closed_form import grooves_per_cycle
from worm_optimizer.evaluation.actuator_limits import ActuatorLimits
from worm_optimizer.evaluation.task import EDGE_ALLOWANCE, Bounds, MarginTask, Points
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


@examples(8)
@given(
    st.integers(0, 10_000),
    st.sampled_from([0.0, 1e-3, 2.5e-3]),
    st.sampled_from([1, -1]),
    st.sampled_from([0.0, 3.0]),
)
def test_no_gait_of_a_dense_grid_is_cheaper(seed, margin, direction, load):
    task = MarginTask(random_robot(seed).replace(rear_load=load), direction, margin)
    exact = exact_front(task, Resolution(41, 21), Zoom())
    grid = dense_grid(task, np.linspace(0.08, 0.4, 21), 801)
    assert bool(len(exact.front)) == bool(len(grid)) or not len(grid)
    assert excess(exact.front, grid) < ACCEPTED


@examples(5)
@given(st.integers(0, 10_000), st.floats(20.0, 120.0), st.floats(3.0, 30.0), st.floats(0.02, 0.12))
def test_no_gait_of_a_dense_grid_within_the_limits_is_cheaper(seed, force, power, speed):
    limits = ActuatorLimits(speed, force, power, stall_force=1.5 * force, no_load_speed=3.0 * speed)
    task = MarginTask(random_robot(seed), limits=limits)
    exact = exact_front(task, Resolution(41, 9), Zoom())
    assert np.all(exact.front.violation <= 0.0)
    assert excess(exact.front, dense_grid(task, np.linspace(0.08, 0.4, 9), 201)) < ACCEPTED


def test_an_edge_is_the_shortest_stroke_but_for_the_stated_allowance():
    task = MarginTask()
    edges = task.edges(np.array([0.15, 0.3]), np.tile(np.linspace(0.01, 0.09, 21), (2, 1)))
    shorter = edges.points.stroke - 3.0 * EDGE_ALLOWANCE
    assert np.all(task.points(shorter, edges.points.frequency).count < edges.points.count)
    assert edges.points.count.tolist() == [3, 6, 3, 6]


@given(st.integers(0, 10_000))
@examples(5)
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
