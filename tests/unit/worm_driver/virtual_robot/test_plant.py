# SPDX-License-Identifier: Apache-2.0
"""The plant, compared with independent solutions of the model and with physical laws.

Free and under loads along the pipe, with its length given by the cable's command or by the cable's force.
"""

import csv
import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from worm_driver.virtual_robot.plant import LOOSE, Plant, PlantEffects, make_grooves
from worm_driver.virtual_robot.virtual_robot import VirtualRobot
from worm_driver.virtual_robot.virtual_settings import load_settings
from worm_driver.virtual_robot.wire.faults import FaultBoard, make_fault
from worm_msgs.conditions import Conditions
from worm_msgs.gait import FORWARD, REVERSE
from worm_msgs.robot_parameters import RobotParameters

PAPER = RobotParameters()
NO_EFFECTS = PlantEffects(0.0, 0.0, 0.0, math.inf)
ROUGH = PlantEffects(2e-4, 0.03, 5e-5, 1.0)
STIFFNESS = 6400.0  # N/m
COMPLIANT = replace(NO_EFFECTS, cable_stiffness=STIFFNESS)
DRY = replace(PAPER, rear_dry_friction=0.3, front_dry_friction=0.3)
BODY = replace(load_settings().body, rear_dry_friction=0.0, front_dry_friction=0.0)
GRAVITY = 9.80665
WEIGHT = (PAPER.rear_mass + PAPER.front_mass) * GRAVITY
#: anchors below the fins, so that both deflect equally
EVEN = replace(PAPER, initial_length=17 * PAPER.pitch)


def plant_of(conditions=Conditions(), parameters=PAPER, effects=NO_EFFECTS, step=1e-3):  # noqa: B008
    grooves = (make_grooves(parameters, effects, seed) for seed in (1, 2))
    return Plant(parameters, effects, *grooves, step, conditions)


def loads(conditions, parameters, x1=0.0):
    weight = conditions.gravity
    return parameters.rear_mass * weight + conditions.tether(x1), parameters.front_mass * weight


def rest(plant, state, duration, laws=(FORWARD, FORWARD)):
    for _ in range(round(duration / plant.step_s)):
        state = plant.step(state, 0.0, laws)
    return state


def play(plant, stroke, frequency, cycles=5, law=FORWARD):
    """Return the states of a gait from rest at each step, the initial one first."""
    states = [plant.at_rest((law, law))]
    for index in range(round(cycles / frequency / plant.step_s)):
        phase = 2 * math.pi * frequency * (index + 1) * plant.step_s
        command = min(-0.5 * stroke * (1 - math.cos(phase)), -1e-9)
        states.append(plant.step(states[-1], command, (law, law)))
    return states


def grooves_per_cycle(plant, states, cycles=5, last=3):
    first = (len(states) - 1) * (cycles - last) // cycles
    gained = plant.positions(states[-1])[0] - plant.positions(states[first])[0]
    return gained / plant.parameters.pitch / last


def mean_power(plant, states, cycles=5, last=3):
    """Return the mean power of the last cycles."""
    counted = states[1 + (len(states) - 1) * (cycles - last) // cycles :]
    return sum(plant.electrical_power(state) for state in counted) / len(counted)


# --- without a load -------------------------------------------------------------------------------


def test_without_its_effects_it_is_the_model(shared):
    with (shared / "reference" / "gaits.csv").open() as file:
        rows = [{key: float(value) for key, value in row.items()} for row in csv.DictReader(file)]
    for row in rows[::3]:
        parameters = replace(
            PAPER,
            initial_length=row["L0_m"],
            switching_threshold=PAPER.switching_threshold + row["margin_m"],
        )
        plant = plant_of(parameters=parameters)
        law = int(row["direction"])
        states = play(plant, row["stroke_m"], row["frequency_Hz"], law=law)
        grooves = grooves_per_cycle(plant, states)
        assert grooves * law == pytest.approx(row["grooves_per_cycle"], abs=2e-3), row
        assert mean_power(plant, states) == pytest.approx(row["power_W"], rel=0.01), row


def test_the_slack_comes_back_after_a_rest():
    plant = plant_of(parameters=DRY, effects=ROUGH)
    state = play(plant, 0.07, 0.2, 1)[-1]
    assert state.length_change == pytest.approx(-PAPER.gain * PAPER.slack, abs=1e-3)
    state = rest(plant, state, 3.0)
    assert state.length_change == pytest.approx(0.0, abs=1e-5)


def test_the_scatter_comes_from_the_seed():
    assert make_grooves(PAPER, ROUGH, 3) == make_grooves(PAPER, ROUGH, 3)
    grooves = make_grooves(PAPER, ROUGH, 4)
    assert grooves != make_grooves(PAPER, ROUGH, 3)
    mean = sum(grooves.thresholds) / len(grooves.thresholds)
    assert mean == pytest.approx(PAPER.switching_threshold, abs=5e-5)
    assert max(grooves.thresholds) - min(grooves.thresholds) > 4e-4


# --- under loads along the pipe ---------------------------------------------------------------------


@given(slope=st.floats(-80.0, 80.0), tether=st.floats(0.0, 20.0))
def test_it_starts_in_the_equilibrium(slope, tether):
    """Both fins deflect equally, and carry weight and tether together."""
    plant = plant_of(Conditions(slope, tether), EVEN)
    load = WEIGHT * math.sin(math.radians(slope)) + tether
    assume(abs(load) > 0.1)  # a smaller one takes minutes through the clearance
    state = plant.at_rest()
    stiffness = PAPER.engaged_stiffness if load > 0.0 else PAPER.disengaged_stiffness
    expected = -math.copysign(PAPER.clearance / 2 + abs(load) / 2 / stiffness, load)
    assert plant.positions(state)[0] == pytest.approx(expected, abs=2e-7)
    assert plant.positions(state) == pytest.approx(
        plant.positions(rest(plant, state, 2.0)), abs=2e-7
    )
    assert (state.rear_groove, state.front_groove) == (0, 17)


@pytest.mark.parametrize("effects", [NO_EFFECTS, COMPLIANT])
def test_the_cable_carries_the_difference_between_front_fin_and_front_load(effects):
    conditions = Conditions(30.0, 2.0)
    plant = plant_of(conditions, EVEN, effects)
    state = plant.at_rest()
    (x1, x2), (rear, front) = plant.positions(state), loads(conditions, EVEN)
    carried = [
        -EVEN.engaged_stiffness * (deflection + EVEN.clearance / 2)
        for deflection in (x1, x2 - 17 * EVEN.pitch)
    ]
    assert sum(carried) == pytest.approx(rear + front, rel=1e-4)
    bellows = EVEN.bellows_stiffness * (EVEN.unstressed_length - (x2 - x1))
    assert state.cable_force == pytest.approx(bellows + carried[1] - front, rel=1e-3)


def test_a_robot_slides_under_a_load_that_the_fins_do_not_hold():
    plant = plant_of(Conditions(tether_n=100.0))
    state = plant.at_rest()
    assert plant.positions(state)[0] == 0.0
    assert plant.positions(rest(plant, state, 2.0))[0] < -10 * PAPER.pitch


def test_loose_fins_slide_at_the_speed_of_the_friction():
    plant = plant_of(Conditions(30.0))
    before = rest(plant, plant.at_rest((LOOSE, LOOSE)), 1.0, (LOOSE, LOOSE))
    after = rest(plant, before, 1.0, (LOOSE, LOOSE))
    speed = plant.positions(after)[0] - plant.positions(before)[0]
    assert speed == pytest.approx(-0.5 * WEIGHT / (2 * PAPER.viscous_friction), rel=1e-6)


@pytest.mark.parametrize(
    ("slope", "margin", "grooves"),
    [(0, 0.0, 2), (60, 0.0, 2), (90, 0.0, 0), (15, 0.0025, 0), (30, 0.001, 2), (30, 0.002, 0)],
)
def test_where_the_papers_cruise_gait_climbs(slope, margin, grooves):
    """Grooves from an independent integration of the paper's model."""
    threshold = PAPER.switching_threshold + margin
    plant = plant_of(Conditions(slope), replace(PAPER, switching_threshold=threshold))
    found = grooves_per_cycle(plant, play(plant, 0.0754, 0.147))
    assert found == pytest.approx(grooves, abs=2e-3)


def test_the_reverse_gait_uphill_is_the_mirror_image():
    up, down = plant_of(Conditions(25.0), EVEN), plant_of(Conditions(-25.0), EVEN)
    forward, reverse = play(up, 0.08, 0.2, 2), play(down, 0.08, 0.2, 2, REVERSE)
    for ahead, back in zip(forward[::100], reverse[::100], strict=True):
        (x1, x2), (y1, y2) = up.positions(ahead), down.positions(back)
        assert y1 == pytest.approx(EVEN.initial_length - x2, abs=1e-6)
        assert y2 == pytest.approx(EVEN.initial_length - x1, abs=1e-6)


@pytest.mark.parametrize(
    ("body", "effects"), [(PAPER, NO_EFFECTS), (PAPER, COMPLIANT), (DRY, ROUGH)]
)
def test_the_cable_pays_for_the_climb(body, effects):
    """Work of the cable, minus the energy stored in bellows and weight, is at least the loss by friction."""
    conditions = Conditions(20.0, 2.0, 3.0)
    plant = plant_of(conditions, body, effects)
    states = play(plant, 0.08, 0.15, 3)
    work = lost = stored = 0.0
    for before, after in itertools.pairwise(states):
        (x1, x2), (y1, y2) = plant.positions(before), plant.positions(after)
        rear, front = loads(conditions, PAPER, x1)
        stored += rear * (y1 - x1) + front * (y2 - x2)
        lost += PAPER.viscous_friction * ((y1 - x1) ** 2 + (y2 - x2) ** 2) / plant.step_s
        lost += PAPER.bellows_damping * after.length_rate**2 * plant.step_s
        work -= after.cable_force * after.length_rate * plant.step_s
    preload = PAPER.unstressed_length - PAPER.initial_length
    ends = (preload - states[-1].length_change, preload - states[0].length_change)
    stored += 0.5 * PAPER.bellows_stiffness * (ends[0] ** 2 - ends[1] ** 2)
    assert work - stored > lost > 0.5 * (work - stored)


def test_loads_of_the_body_act_as_those_of_the_conditions():
    stated = replace(PAPER, rear_load=3.0 + 0.5 * PAPER.rear_mass * GRAVITY)
    stated = replace(stated, front_load=0.5 * PAPER.front_mass * GRAVITY)
    body, pipe = plant_of(Conditions(), stated), plant_of(Conditions(30.0, 3.0))
    for one, other in zip(play(body, 0.08, 0.2, 1), play(pipe, 0.08, 0.2, 1), strict=True):
        assert body.positions(one) == pytest.approx(pipe.positions(other), abs=1e-9)


def test_a_fault_changes_the_load_for_its_time(settings):
    board = FaultBoard(
        [
            make_fault("slope", start=1.0, duration=2.0, value=30.0),
            make_fault("tether", start=2.0, duration=2.0, value=5.0),
        ]
    )
    robot = VirtualRobot(settings, board)
    found = []
    for time in (0.5, 1.5, 2.5, 3.5, 4.5):
        robot.advance(time)
        found.append((robot.plant.conditions.slope_deg, robot.plant.conditions.tether_n))
    assert found == [(0.0, 0.0), (30.0, 0.0), (30.0, 5.0), (0.0, 5.0), (0.0, 0.0)]
    assert robot.plant.positions(robot.state)[0] < -robot.plant.parameters.clearance / 4


def test_a_fault_leaves_the_conditions_admissible(settings):
    faults = make_fault("slope", start=0.0, value=100.0), make_fault("tether", value=-5.0)
    robot = VirtualRobot(replace(settings, conditions=Conditions(5.0, 2.0)), FaultBoard(faults))
    robot.advance(0.1)
    assert robot.plant.conditions == Conditions(90.0, 0.0)


def test_in_slow_water_a_gait_gains_and_costs_what_the_linearised_drag_predicts():
    """The neglected part is half of rho C_d A times the square of the modules' velocity."""
    area, flow = 0.004, 0.6
    factor = 998.2 * area * flow
    linear = replace(
        PAPER,
        viscous_friction=PAPER.viscous_friction + factor,
        rear_load=0.5 * factor * flow,
        front_load=0.5 * factor * flow,
    )
    water = plant_of(Conditions(flow_m_per_s=flow, drag_area_m2=area))
    plain = plant_of(Conditions(), linear)
    states = play(water, 0.078, 0.15), play(plain, 0.078, 0.15)
    gained = [
        grooves_per_cycle(plant, run) for plant, run in zip((water, plain), states, strict=True)
    ]
    energy = [sum(state.mechanical_power for state in run) for run in states]
    assert gained[0] == pytest.approx(gained[1], abs=0.01)
    assert energy[0] == pytest.approx(energy[1], rel=0.01)


# --- a length that follows from the cable's force -----------------------------------------------------


def integrated(stroke, frequency, times):
    """Return x1, x2 (2, n) by SciPy:

    two masses, springs and dampers as in the paper, a cable that only pulls, no switches.
    """
    p, half = BODY, 0.5 * BODY.clearance
    front = round(p.initial_length / p.pitch) * p.pitch
    preload = p.bellows_stiffness * (p.unstressed_length - p.initial_length)

    def fin(stretch):
        beyond = np.sign(stretch) * max(abs(stretch) - half, 0.0)
        return (p.engaged_stiffness if stretch < 0 else p.disengaged_stiffness) * beyond

    def rates(time, state):
        x1, x2, v1, v2 = state
        command = -0.5 * stroke * (1 - math.cos(2 * math.pi * frequency * time))
        wound = min(command, -p.slack)
        change = x2 - x1 - p.initial_length
        cable = max(preload + STIFFNESS * (change - wound), 0.0)
        inner = cable + p.bellows_stiffness * (x2 - x1 - p.unstressed_length)
        inner += p.bellows_damping * (v2 - v1)
        a1 = (inner - p.viscous_friction * v1 - fin(x1)) / p.rear_mass
        a2 = (-inner - p.viscous_friction * v2 - fin(x2 - front)) / p.front_mass
        return [v1, v2, a1, a2]

    start = [0.0, p.initial_length, 0.0, 0.0]
    found = solve_ivp(
        rates, (0.0, times[-1]), start, "Radau", times, rtol=1e-8, atol=1e-10, max_step=0.01
    )
    return found.y[:2]


def test_it_is_the_two_mass_model_with_the_cables_force():
    plant = plant_of(parameters=BODY, effects=COMPLIANT, step=1e-4)
    states = play(plant, 0.025, 0.3, 1)[1:]
    assert {state.rear_groove for state in states} == {0}  # no anchor switches, as in the oracle
    times = plant.step_s * np.arange(1, len(states) + 1)
    expected = integrated(0.025, 0.3, times)
    found = np.array([plant.positions(state) for state in states]).T
    assert np.max(np.abs(found - expected)) < 3e-5


@pytest.mark.parametrize(
    ("effects", "least", "most"), [(COMPLIANT, 2e-4, 5e-3), (NO_EFFECTS, 0.0, 1e-12)]
)
def test_load_changes_the_length_of_a_compliant_cable_only(effects, least, most):
    plant = plant_of(parameters=BODY, effects=effects)
    held, free = (play(plant, 0.07, 0.2, 2, law) for law in (FORWARD, LOOSE))
    apart = max(abs(a.length_change - b.length_change) for a, b in zip(held, free, strict=True))
    assert least <= apart <= most


def test_a_cable_never_pushes_and_the_robot_walks():
    plant = plant_of(parameters=load_settings().body, effects=COMPLIANT)
    states = play(plant, 0.09, 0.4)
    assert min(state.cable_force for state in states) == 0.0
    assert all(state.mechanical_power >= 0.0 for state in states)
    assert plant.positions(states[-1])[0] > 3 * BODY.pitch
