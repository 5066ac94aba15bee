# SPDX-License-Identifier: Apache-2.0
"""Loads and waveforms, compared with their closed forms, and the gaits without them."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from random_cases import examples, random_case

from worm_model.gait import FORWARD, REVERSE, Gait, Profile
from worm_model.loads import under
from worm_model.parameters import PAPER
from worm_model.simulation.actuation import length_change_range
from worm_model.simulation.batch import evaluate_gaits
from worm_model.simulation.closed_form import (
    cliff_margin,
    grooves_per_cycle,
    largest_load,
    largest_static_load,
)
from worm_model.simulation.simulator import LoadError, evaluate_gait, simulate
from worm_msgs.conditions import LEVEL, Conditions
from worm_msgs.robot_parameters import STANDARD_GRAVITY

CRUISE = Gait(0.0754, 0.147)  # the paper's

WAVEFORMS = st.builds(
    Gait,
    stroke=st.floats(0.01, 0.08),
    frequency=st.floats(0.08, 0.4),
    pretension=st.sampled_from([0.0, 0.004, 0.02]),
    contraction_share=st.floats(0.1, 0.9),
    profile=st.sampled_from(list(Profile)),
    ramp_share=st.floats(0.1, 0.5),
)


@examples(15)
@given(WAVEFORMS)
def test_the_range_of_any_waveform_is_that_of_the_periodic_state(gait: Gait) -> None:
    cycles = 15
    times = np.linspace((cycles - 1) * gait.period, cycles * gait.period, 5001)
    change = simulate(gait, PAPER, cycles).at(times).length - PAPER.initial_length
    lowest, highest = length_change_range(gait, PAPER)
    assert lowest == pytest.approx(change.min(), abs=1e-7)
    assert highest == pytest.approx(change.max(), abs=1e-7)


@pytest.mark.parametrize("seed", range(21))
def test_equal_halves_of_a_cosine_are_the_papers_gait(seed: int) -> None:
    """Halves that differ by rounding alone are computed as two, with the results of one sinusoid."""
    _, gait, parameters = random_case(seed)
    split = dataclasses.replace(gait, contraction_share=0.5 + 1e-13)
    one, other = (evaluate_gait(g, parameters) for g in (gait, split))
    assert other.grooves_per_cycle == pytest.approx(one.grooves_per_cycle, abs=1e-8)
    assert other.power == pytest.approx(one.power, rel=1e-8)


@pytest.mark.parametrize("direction", [FORWARD, REVERSE])
@pytest.mark.parametrize("side", [1, -1])
def test_a_load_that_the_fins_do_not_hold_is_reported(direction: int, side: int) -> None:
    gait = dataclasses.replace(CRUISE, direction=direction)
    held = largest_static_load(PAPER, side, gait)
    simulate(gait, PAPER.replace(rear_load=0.999 * side * held)).at([0.0])
    beyond = PAPER.replace(front_load=1.001 * side * held)
    with pytest.raises(LoadError, match="rear_load") as error:
        evaluate_gait(gait, beyond)
    assert f"{held:.4g} N" in str(error.value)
    with pytest.raises(LoadError):
        simulate(gait, beyond).at([0.0])
    table = evaluate_gaits(gait.stroke, gait.frequency, 0.0, direction, parameters=beyond)
    assert np.isnan(table.speed)
    assert np.isnan(table.power)


@pytest.mark.parametrize("seed", range(12))
def test_the_cliff_under_a_load_is_that_of_slow_gaits(seed: int) -> None:
    """Q/(k_eng + k_dis) per newton, over random robots, loads and directions."""
    rng = np.random.default_rng(seed)
    changes = {
        key: float(getattr(PAPER, key) * rng.uniform(0.85, 1.15))
        for key in ("engaged_stiffness", "disengaged_stiffness", "gain", "clearance")
    }
    phase = rng.uniform(0.001, 0.006)
    robot = PAPER.replace(
        initial_length=17 * PAPER.pitch + phase, switching_threshold=0.016, **changes
    )
    direction, load = int(rng.choice([1, -1])), float(rng.uniform(-2.0, 2.0))
    loaded = robot.replace(rear_load=0.5 * load, front_load=0.5 * load)
    stiffness = robot.engaged_stiffness + robot.disengaged_stiffness
    cliff = cliff_margin(loaded, direction)
    free = cliff_margin(robot, direction)
    assert cliff == pytest.approx(free - direction * load / stiffness, abs=1e-12)
    stroke = (
        2.0 * robot.pitch + 0.024
    ) / robot.gain + robot.slack  # beyond the edge of two grooves
    margins = cliff + np.array([-5e-5, 5e-5])
    table = evaluate_gaits(stroke, 0.004, margins, direction, parameters=loaded)
    before, after = np.round(table.grooves_per_cycle)
    assert before > after


@pytest.mark.parametrize("seed", range(12))
def test_the_largest_load_is_that_of_a_slow_gait(seed: int) -> None:
    rng = np.random.default_rng([seed, 1])
    robot = PAPER.replace(initial_length=float(17 * PAPER.pitch + rng.uniform(-0.008, 0.008)))
    gait = Gait(
        stroke=rng.uniform(0.06, 0.08),
        frequency=0.004,
        direction=int(rng.choice([1, -1])),
        pretension=float(rng.choice([0.0, 0.01])),
        profile=Profile(int(rng.integers(0, 2))),
    )
    for grooves in (1, 2):
        load = largest_load(gait, robot, grooves)
        if np.isnan(load):
            assert grooves_per_cycle(gait, robot) < grooves
            continue
        found = [
            evaluate_gait(gait, robot.replace(rear_load=gait.direction * q)).grooves_per_cycle
            for q in (load - 0.2, load + 0.2)
        ]
        assert round(found[0]) >= grooves > round(found[1])


def test_conditions_are_loads_and_friction() -> None:
    assert under(LEVEL, PAPER) == PAPER
    vertical = under(Conditions(slope_deg=90.0), PAPER)
    weight = PAPER.rear_mass * STANDARD_GRAVITY
    assert (vertical.rear_load, vertical.front_load) == pytest.approx((weight, weight))
    pulled = under(Conditions(tether_n=2.0, tether_n_per_m=0.5, distance_m=4.0), PAPER)
    assert (pulled.rear_load, pulled.front_load) == (4.0, 0.0)
    flow = under(Conditions(flow_m_per_s=0.5, drag_area_m2=1e-3), PAPER)
    assert flow.rear_load == flow.front_load == pytest.approx(0.5 * 998.2 * 1e-3 * 0.25)
    added = flow.viscous_friction - PAPER.viscous_friction
    speed = 1e-4  # of a module: the linear part of the drag
    moving = 0.5 * 998.2 * 1e-3 * (0.5 + speed) ** 2
    assert flow.rear_load + added * speed == pytest.approx(moving, abs=1e-8)
    along = under(Conditions(flow_m_per_s=-0.5, drag_area_m2=1e-3), PAPER)
    assert along.rear_load == -flow.rear_load
    assert along.viscous_friction == flow.viscous_friction
