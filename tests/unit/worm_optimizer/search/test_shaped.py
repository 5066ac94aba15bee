# SPDX-License-Identifier: Apache-2.0
"""The front of shaped gaits, compared with random gaits of its box and the paper's front; its limits and accuracy."""

import dataclasses
from functools import cache

import numpy as np
import pytest
from gaits_for_tests import COARSE

from worm_model.gait import Gait, Profile
from worm_model.parameters import PAPER
from worm_model.simulation.simulator import cost_of_transport, evaluate_gait
from worm_optimizer.evaluation.actuator_limits import ActuatorLimits, peaks
from worm_optimizer.evaluation.command_shape import SHAPE_ROW, shapes_of
from worm_optimizer.evaluation.task import Bounds, MarginTask, Points
from worm_optimizer.search.corners import FINE, Columns, ShapeBounds, corners
from worm_optimizer.search.exact import ExactFront, Zoom, exact_front
from worm_optimizer.search.shaped import ShapedTask, Track

ACCEPTED = 1e-4  # relative excess of power over a random gait


@cache
def shaped_front(margin: float) -> ExactFront:
    """Return the front of the paper's robot over shaped gaits at a margin in m, on few frequencies."""
    return exact_front(ShapedTask(MarginTask(margin=margin), ShapeBounds()), COARSE, Zoom(9, 6))


def random_gaits(task: MarginTask, count: int, seed: int) -> Points:
    """Return admissible gaits of the box with any shape."""
    rng = np.random.default_rng(seed)
    box, shapes = task.bounds, ShapeBounds()
    reach = rng.uniform(box.stroke_low, box.stroke_high, count)
    stroke = rng.uniform(box.stroke_low, reach)
    shape = shapes_of(
        count,
        pretension=reach - stroke,
        contraction_share=rng.uniform(*shapes.contraction_share, count),
        profile=rng.integers(0, 2, count),
        ramp_share=rng.uniform(*shapes.ramp_share, count),
    )
    points = task.points(stroke, rng.uniform(box.frequency_low, box.frequency_high, count), shape)
    return points.take(points.admissible)


def largest_excess(front: Points, others: Points) -> float:
    """Return the largest relative excess of a gait's power over that of others that are as fast or faster."""
    order = np.argsort(others.count * others.frequency)
    speed, power = (others.count * others.frequency)[order], others.power[order]
    best = np.append(np.minimum.accumulate(power[::-1])[::-1], np.inf)
    place = np.searchsorted(speed, front.count * front.frequency * (1.0 - 1e-9))
    return float(np.max(front.power / best[place] - 1.0))


@pytest.mark.parametrize(("margin", "cost"), [(0.0, 46.9), (3.4e-3, 57.4)])
def test_the_front_reaches_the_goal_and_no_random_gait_of_the_box_dominates_it(margin, cost):
    front = shaped_front(margin).front
    costs = cost_of_transport(front.speed, front.power, PAPER.mass)
    assert costs.min() <= cost
    best = int(np.argmin(costs))
    assert front.stroke[best] + front.shape["pretension"][best] <= 0.09 + 1e-12
    assert front.frequency[best] <= 0.4
    assert front.shape["ramp_share"][best] >= 0.1
    others = random_gaits(MarginTask(margin=margin), 20_000, 1)
    assert largest_excess(front, others) < ACCEPTED


def test_every_gait_gains_its_grooves_when_it_is_evaluated_again():
    front = shaped_front(3.4e-3).front
    for row in range(0, len(front), 7):
        fields = {name: float(front.shape[name][row]) for name in SHAPE_ROW.names}
        fields["profile"] = Profile(int(fields["profile"]))
        gait = Gait(float(front.stroke[row]), float(front.frequency[row]), 1, 3.4e-3, **fields)
        again = evaluate_gait(gait)
        assert again.grooves_per_cycle == pytest.approx(front.grooves[row], abs=1e-3)
        assert again.power == pytest.approx(front.power[row], rel=1e-9)


def test_at_a_corner_neither_less_reach_nor_more_pretension_keeps_the_grooves():
    task, hair = MarginTask(), 1e-6
    columns = Columns(np.array([0.15]), np.array([0.0]), np.array([6]), np.array([1.0]))
    found, gains = corners(task, ShapeBounds(), columns, np.array([[0.65, 0.1]]), FINE)
    assert gains.all()
    assert found.count.tolist() == [6]
    tighter = found.shape.copy()
    tighter["pretension"] += hair
    assert task.points(found.stroke - hair, found.frequency, found.shape).count[0] < 6
    assert task.points(found.stroke - hair, found.frequency, tighter).count[0] < 6
    looser = found.shape.copy()
    looser["pretension"] -= hair
    assert task.points(found.stroke + hair, found.frequency, looser).count[0] == 6


def test_ramps_too_short_for_any_pretension_become_as_long_as_needed():
    task, needed = MarginTask(margin=3.4e-3), 2e-5
    columns = Columns(np.full(2, 0.22), np.full(2, 3.4e-3), np.full(2, 6), np.ones(2))
    found, gains = corners(task, ShapeBounds(), columns, np.array([[0.55, 0.1], [0.55, 0.2]]), FINE)
    assert gains.all()
    assert found.shape["pretension"].tolist() == [0.0, 0.0]
    assert found.shape["ramp_share"][0] > 0.2
    assert found.shape["ramp_share"] == pytest.approx(found.shape["ramp_share"][0], abs=2e-5)
    assert found.power == pytest.approx(found.power[0], rel=2e-5)
    shorter = found.shape.copy()
    shorter["ramp_share"] -= needed
    assert np.all(task.points(found.stroke, found.frequency, shorter).count < 6)


def test_a_limit_of_the_pushing_force_bounds_the_contraction_share_at_every_frequency():
    """Shares beyond the limit between two searched frequencies would leave gaps in the front."""
    robot, limits = PAPER.replace(one_sided_cable=True), ActuatorLimits(pushing_force=20.0)
    task = MarginTask(robot, limits=limits)
    shaped = ShapedTask(task, ShapeBounds())
    front = exact_front(shaped, COARSE, Zoom(5, 4)).front
    push = peaks(front.stroke, front.frequency, 1, robot, limits, front.shape).push
    assert np.all(push <= 20.0)
    assert np.count_nonzero(push > 19.99) > 0.5 * len(front)
    frequency = np.linspace(0.1, 0.2, 41)  # columns of the survey and between them
    edges = shaped.edges(frequency, np.tile(np.linspace(0.01, 0.09, 21), (41, 1)))
    two = edges.points.take((edges.points.count == 6) & (edges.points.shape["pretension"] > 0.0))
    assert np.unique(two.frequency).tolist() == frequency.tolist()
    within = random_gaits(task, 20_000, 3)
    assert largest_excess(front, within) < ACCEPTED


def test_the_corner_of_the_papers_shape_is_the_papers_edge():
    task, frequency = MarginTask(margin=3.4e-3), np.array([0.1, 0.15, 0.2])
    paper = task.edges(frequency, np.tile(np.linspace(0.01, 0.09, 41), (3, 1)))
    of_paper = paper.points
    assert of_paper.count.tolist() == [3, 6] * 3
    columns = Columns(
        frequency[paper.column], np.full(6, 3.4e-3), of_paper.count, np.full(6, Profile.COSINE)
    )
    unloaded = ShapeBounds(pretension=(0.0, 0.0))
    found, gains = corners(task, unloaded, columns, np.full((6, 2), 0.5), FINE)
    assert gains.all()
    assert found.stroke == pytest.approx(of_paper.stroke, abs=1e-7)
    assert found.power == pytest.approx(of_paper.power, rel=2e-6)


def test_where_the_longest_swing_loses_a_groove_the_papers_gait_is_not_cheaper():
    """At 0.23 Hz and a margin of 3.4 mm, only the sinusoid gains two grooves up to a stroke of 79 mm."""
    task, frequency = MarginTask(margin=3.4e-3), np.array([0.23])
    narrow = dataclasses.replace(task, bounds=Bounds(frequency_low=0.23, frequency_high=0.23))
    scan = np.linspace(0.01, 0.09, 161)[np.newaxis]
    paper = task.edges(frequency, scan, np.array([6]))
    assert paper.column.tolist() == [0]
    shaped = ShapedTask(narrow, ShapeBounds((0.0, 0.09), (0.3, 0.7), (0.1, 0.5)))
    columns = Columns(frequency, np.full(1, 3.4e-3), np.full(1, 6), np.full(1, Profile.COSINE))
    found, gains = corners(task, shaped.shapes, columns, np.full((1, 2), 0.5), FINE)
    assert gains.all()
    assert np.all(found.power <= paper.points.power * (1.0 + ACCEPTED))
    edges = shaped.edges(frequency, scan, np.array([6]))
    assert edges.points.power.min() <= paper.points.power[0] * (1.0 + ACCEPTED)


def test_between_margins_shares_at_a_bound_stay_within_it():
    """Interpolation of 0.1 and 0.1 may yield 0.0999…"""
    task = ShapedTask(MarginTask(), ShapeBounds(), (0.0, 0.004))
    frequency = np.array([0.1, 0.3])
    tracks = [Track(m, 3, 1.0, frequency, np.full((2, 2), [0.9, 0.1])) for m in task.nodes]
    task.__dict__["tracks"] = tuple(tracks)
    margins = np.linspace(0.0, 0.004, 41)
    found = task.edges(np.full(41, 0.2), np.full((41, 2), 0.05), margin=margins)
    shape = found.points.shape
    own = shape["profile"] == Profile.TRAPEZOID
    assert np.count_nonzero(own) > 1
    assert np.all((shape["ramp_share"][own] >= 0.1) & (shape["contraction_share"][own] <= 0.9))


SCANNED = PAPER.replace(one_sided_cable=True, rear_dry_friction=0.3, front_dry_friction=0.3)
SLOW = Bounds(frequency_low=0.12, frequency_high=0.12)


def test_near_the_cliff_a_scan_finds_the_gaits_of_a_search_at_its_margin():
    """Shares change quickly there: at 3.2 mm, those of a margin of 2 mm need a fifth more power."""
    task = MarginTask(SCANNED, bounds=SLOW)
    scanned = ShapedTask(task, ShapeBounds(), (0.002, 0.004))
    margins = np.array([2e-3, 3e-3, 3.1e-3, 3.2e-3, 3.25e-3])
    strokes = np.linspace(0.01, 0.09, 21)
    edges = scanned.edges(np.full(5, 0.12), np.tile(strokes, (5, 1)), margin=margins)
    for column, margin in enumerate(margins):
        alone = ShapedTask(task.with_margin(margin), ShapeBounds())
        best = alone.edges(np.array([0.12]), strokes[np.newaxis]).points
        found = edges.points.take((edges.column == column) & (edges.points.count == 6))
        assert found.power.min() <= best.power[best.count == 6].min() * 1.01


def test_a_gait_that_loses_its_grooves_with_a_long_stroke_is_found_at_a_higher_pretension():
    task, shapes = MarginTask(SCANNED, margin=3.2e-3), ShapeBounds()
    columns = Columns(np.array([0.165]), np.array([3.2e-3]), np.array([6]), np.array([1.0]))
    shares = np.array([[0.7213, 0.3575]])
    found, gains = corners(task, shapes, columns, shares, FINE)
    assert gains.all()
    assert found.shape["pretension"][0] > 0.004
    shape = found.shape.copy()
    shape["pretension"] = 0.0
    strokes = np.linspace(0.05, 0.09, 41)
    without = task.points(strokes, np.full(41, 0.165), np.broadcast_to(shape, 41))
    assert without.count.max() < 6
