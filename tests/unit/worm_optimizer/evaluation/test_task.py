# SPDX-License-Identifier: Apache-2.0
"""The optimisation task: bounds, the threshold of motion, and the actuator limits."""

import math

import numpy as np
import pytest

from worm_model.gait import FORWARD, Gait
from worm_model.parameters import PAPER
from worm_model.simulation.batch import branch_of, evaluate_gaits
from worm_model.simulation.simulator import simulate
from worm_optimizer.evaluation.actuator_limits import ActuatorLimits, peaks
from worm_optimizer.evaluation.task import MarginTask
from worm_optimizer.search.pareto import front_of


def test_standing_still_is_not_admissible():
    """A standing robot needs the least power of all, so it would be Pareto-optimal (model_notes.md, 5)."""
    points = MarginTask().points([0.01, 0.05, 0.07], [0.3575, 0.2, 0.2])
    assert points.count.tolist() == [0, 0, 3]
    assert points.admissible.tolist() == [False, False, True]
    assert points.power.argmin() == 0


def test_longer_strokes_at_equal_frequency_are_not_faster():
    """Remains of the transient must not make a more expensive gait of the same branch Pareto-optimal."""
    strokes = np.linspace(0.075, 0.09, 7)
    points = MarginTask().points(strokes, np.full(7, 0.4))
    assert points.count.tolist() == [6] * 7
    assert len(front_of(points)) == 1
    assert np.all(np.diff(points.power) > 0.0)


def test_a_branch_is_whole_grooves_and_a_given_up_gait_has_none():
    table = evaluate_gaits([0.07, 0.0706, 0.05, 0.07], [0.2, 0.1525, 0.2, 0.2])
    table.min_grooves[:] = [1.0 - 1e-3, 2.0 + 1e-6, -0.3, math.nan]
    assert branch_of(table).tolist() == [1, 2, 0, 0]


def test_limits_exclude_gaits_and_report_the_excess():
    stroke, frequency = np.array([0.0754, 0.09]), np.array([0.1, 0.4])
    limits = ActuatorLimits(cable_force=100.0, electrical_power=38.4)
    free = MarginTask().points(stroke, frequency)
    limited = MarginTask(limits=limits).points(stroke, frequency)
    peak = peaks([0.09], [0.4], FORWARD, PAPER)
    assert free.admissible.tolist() == [True, True]
    assert limited.admissible.tolist() == [True, False]
    assert limited.violation[1] == pytest.approx(max(peak.force / 100.0, peak.power / 38.4) - 1.0)


def test_the_cable_speed_limit_is_that_of_the_command():
    task = MarginTask(limits=ActuatorLimits(cable_speed=math.pi * 0.08 * 0.3))
    points = task.points([0.0799, 0.0801], [0.3, 0.3])
    assert points.admissible.tolist() == [True, False]


def test_the_push_of_a_cycle_is_the_least_cable_force_of_the_simulation():
    fast, slow = Gait(0.09, 0.4), Gait(0.07, 0.02)
    both = [fast.stroke, slow.stroke], [fast.frequency, slow.frequency]
    push = peaks(*both, FORWARD, PAPER).push
    times = fast.period * (2.0 + np.arange(20_000) / 20_000)
    least = simulate(fast).at(times).cable_force.min()
    assert least < -40.0
    assert push == pytest.approx([-least, 0.0], rel=0.01)
