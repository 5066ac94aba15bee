# SPDX-License-Identifier: Apache-2.0
"""Healthy robots near an edge of the grooves per cycle, at every groove phase, and outside of the model."""

import dataclasses

import numpy as np
import pytest
from faulty_robots import EXACT, Fault, followed, run_robots
from foreign_robot import crawl, some_robot

from worm_model.gait import Gait
from worm_model.parameters import PAPER, Parameters
from worm_model.run import LengthSamples, TrackerSamples
from worm_model.simulation.simulator import evaluate_gait
from worm_model.twin.cycle_data import CycleData
from worm_model.twin.data.records import Event, Health, Severity
from worm_model.twin.edges import Edge, edge_of
from worm_model.twin.offline_replay import replay_run

EDGE = Gait(0.070637, 0.2)  # 1 groove according to the model
FAR = Gait(0.08, 0.2)


def at_phase(phase: float) -> Parameters:
    return PAPER.replace(initial_length=17 * PAPER.pitch + phase)


def alarms(events: tuple[Event, ...]) -> list[tuple[str, int]]:
    return [(event.code, event.cycle) for event in events if event.severity > Severity.INFO]


@pytest.mark.parametrize("offset", [-0.0005, 0.0, 0.0002])
def test_near_an_edge_whole_grooves_are_not_judged(offset: float):
    gait = Gait(EDGE.stroke + offset, EDGE.frequency)
    robots = run_robots(gait, [Fault()] * 3, seed=4)
    for k in range(3):
        output = followed(robots.rows(k, tracker=True))
        assert not alarms(output.events)
        assert Health.FAULTY not in output.residuals["health"]
        (event,) = [event for event in output.events if event.code]
        assert (event.code, event.severity, event.cycle) == ("near_edge", Severity.INFO, 0)
        # The twin follows the grooves that the robot gained.
        residuals = output.residuals["rear_position"]
        assert abs(residuals[np.isfinite(residuals)][-1]) < 0.3 * PAPER.pitch


def test_a_robot_that_stands_still_near_an_edge_is_faulty():
    stuck = Fault("rear_load", 60.0, 2)
    output = followed(run_robots(EDGE, [stuck], seed=4).rows(0, tracker=True))
    assert alarms(output.events)


def test_the_edge_is_where_the_simulator_puts_it():
    edge = edge_of(EDGE, PAPER)
    assert (edge.grooves, edge.beyond) == (1, 2)
    beyond = Gait(EDGE.stroke + edge.distance + 1e-4, EDGE.frequency)
    assert round(evaluate_gait(beyond).grooves_per_cycle) == 2
    assert not edge_of(FAR, PAPER).is_near
    assert edge_of(FAR, at_phase(-0.003)).of_threshold


def test_the_probability_of_other_grooves_depends_on_the_distance():
    near, far = Edge(1, 2, 0.0002), Edge(1, 2, 0.0012)
    assert 0.5 > near.chance(1, 2) > far.chance(1, 2) > 0.0
    assert near.chance(2, 1) == pytest.approx(1.0 - near.chance(1, 2))
    assert near.chance(1, 0) == Edge(1, 1).chance(1, 2) == 0.0
    assert CycleData(1, np.zeros(0), np.zeros(0), None, fewer=0.3).at_edge(-1) == 0.3


@pytest.mark.parametrize("phase", [-0.0051, 0.0055, 0.006])
@pytest.mark.parametrize("gait", [FAR, Gait(0.085, 0.25)])
def test_a_run_starts_in_the_equilibrium_of_the_fins_at_every_groove_phase(
    phase: float, gait: Gait
):
    parameters = at_phase(phase)
    robots = run_robots(gait, [Fault()] * 2, seed=3, truth=parameters, lab=EXACT)
    for k in range(2):
        output = followed(robots.rows(k, tracker=True), parameters)
        assert not alarms(output.events)
        assert not [e for e in output.events if "bent fins" in e.text]


@pytest.mark.parametrize("tracker", [True, False])
@pytest.mark.parametrize("fin", ["rear", "front"])
def test_the_same_miss_is_reported_twice_at_most(fin: str, tracker: bool):
    rows = run_robots(FAR, [Fault(fin, 4, 2)], seed=5, cycles=6).rows(0, tracker=tracker)
    found = alarms(followed(rows).events)
    assert found == [(f"missed_groove_{fin}", 2), (f"missed_groove_{fin}", 3)]


@pytest.mark.parametrize("tracker", [True, False])
@pytest.mark.parametrize("gait", [FAR, Gait(0.06, 0.3), EDGE])
def test_a_healthy_robot_outside_of_the_model_has_no_false_cause(gait: Gait, tracker: bool):
    for seed in range(2):
        run = crawl(some_robot(seed), gait, seed=seed).run
        if not tracker:
            run = dataclasses.replace(run, tracker=TrackerSamples(), measured=LengthSamples())
        replay = replay_run(run, PAPER)
        assert not alarms(replay.notices)
        assert Health.FAULTY not in replay.residuals["health"]


def test_a_tether_on_the_rear_module_is_not_called_a_slope_alone():
    rows = run_robots(FAR, [Fault("rear_load", 3.0, 3)], seed=6).rows(0, tracker=True)
    (text,) = [e.text for e in followed(rows).events if e.code == "load_up"]
    assert "tether" in text
    assert "slipped cable" not in text
