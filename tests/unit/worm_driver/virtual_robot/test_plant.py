# SPDX-License-Identifier: Apache-2.0
"""The plant, compared with an independent solution of the model and with physical laws."""

import csv
import math
from dataclasses import replace

import pytest

from worm_driver.virtual_robot.plant import LOOSE, Plant, PlantEffects, make_grooves
from worm_msgs.gait import FORWARD, REVERSE
from worm_msgs.robot_parameters import RobotParameters

PAPER = RobotParameters()
NO_EFFECTS = PlantEffects(0.0, 0.0, 0.0, math.inf)
ROUGH = PlantEffects(2e-4, 0.03, 5e-5, 1.0)
DRY = replace(PAPER, rear_dry_friction=0.3, front_dry_friction=0.3)


def make_plant(parameters=PAPER, effects=NO_EFFECTS, step=1e-3, seed=1):
    rear, front = (make_grooves(parameters, effects, seed + i) for i in range(2))
    return Plant(parameters, effects, rear, front, step)


def gait(stroke, frequency, plant, cycles=5, law=FORWARD):
    """Return the states of a gait from rest; the slack is taken up at its first step."""
    state, states = plant.at_rest(), []
    for index in range(round(cycles / frequency / plant.step_s)):
        phase = 2 * math.pi * frequency * (index + 1) * plant.step_s
        command = min(-0.5 * stroke * (1 - math.cos(phase)), -1e-9)
        state = plant.step(state, command, (law, law))
        states.append(state)
    return states


def of_last_cycles(plant, states, cycles=5, last=3):
    """Return grooves per cycle and mean power of the last cycles."""
    first = round(len(states) * (cycles - last) / cycles)
    gained = plant.positions(states[-1])[0] - plant.positions(states[first - 1])[0]
    power = sum(plant.electrical_power(state) for state in states[first:]) / (len(states) - first)
    return gained / plant.parameters.pitch / last, power


def test_without_its_effects_it_is_the_model(shared):
    with (shared / "reference" / "gaits.csv").open() as file:
        rows = [{key: float(value) for key, value in row.items()} for row in csv.DictReader(file)]
    for row in rows[::3]:
        parameters = replace(
            PAPER,
            initial_length=row["L0_m"],
            switching_threshold=PAPER.switching_threshold + row["margin_m"],
        )
        plant = make_plant(parameters)
        law = int(row["direction"])
        states = gait(row["stroke_m"], row["frequency_Hz"], plant, law=law)
        grooves, power = of_last_cycles(plant, states)
        assert grooves * law == pytest.approx(row["grooves_per_cycle"], abs=2e-3), row
        assert power == pytest.approx(row["power_W"], rel=0.01), row


def test_it_converges_with_the_step():
    def power(step):
        plant = make_plant(step=step)
        return of_last_cycles(plant, gait(0.07, 0.2, plant, cycles=3), cycles=3, last=1)[1]

    coarse, middle, fine = (power(step) for step in (1e-3, 5e-4, 2.5e-4))
    assert abs(middle - fine) < 0.6 * abs(coarse - middle)
    assert abs(coarse - fine) < 0.01 * fine


def test_reverse_is_the_mirror_image_of_forward():
    # The mirror preserves the pipe only if both fins are in the middle of their grooves.
    plant = make_plant(replace(PAPER, initial_length=17 * PAPER.pitch))
    forward = gait(0.08, 0.2, plant, cycles=2)
    reverse = gait(0.08, 0.2, plant, cycles=2, law=REVERSE)
    length = plant.parameters.initial_length
    assert plant.positions(forward[-1])[0] > PAPER.pitch
    for ahead, back in zip(forward[::100], reverse[::100], strict=True):
        # With equal masses the mirror swaps the modules and turns the axis around.
        x1, x2 = plant.positions(ahead)
        y1, y2 = plant.positions(back)
        assert y1 == pytest.approx(length - x2, abs=1e-9)
        assert y2 == pytest.approx(length - x1, abs=1e-9)


def test_rest_is_rest():
    plant = make_plant(DRY, ROUGH)
    state = plant.at_rest()
    for _ in range(2000):
        state = plant.step(state, 0.0, (FORWARD, FORWARD))
    assert plant.positions(state) == pytest.approx((0.0, PAPER.initial_length), abs=1e-12)
    assert plant.electrical_power(state) == pytest.approx(PAPER.idle_power)


def test_anchors_stand_in_grooves_near_their_fins():
    plant = make_plant(DRY, ROUGH)
    for state in gait(0.08, 0.2, plant, cycles=2):
        for position, groove in zip(
            plant.positions(state), (state.rear_groove, state.front_groove), strict=True
        ):
            assert isinstance(groove, int)
            assert abs(position - groove * PAPER.pitch) < 0.0175 + 0.002


def test_the_cable_pays_for_all_losses():
    """The cable's work, minus the energy stored in the bellows, is never less than the loss by friction."""
    plant = make_plant(DRY, ROUGH)
    work = dissipated = 0.0
    previous = plant.at_rest()
    start = previous
    for state in gait(0.07, 0.2, plant, cycles=3):
        (x1, x2), (y1, y2) = plant.positions(previous), plant.positions(state)
        dissipated += PAPER.viscous_friction * ((y1 - x1) ** 2 + (y2 - x2) ** 2) / plant.step_s
        dissipated += PAPER.bellows_damping * state.length_rate**2 * plant.step_s
        work -= state.cable_force * state.length_rate * plant.step_s
        previous = state
    rest = PAPER.unstressed_length - PAPER.initial_length
    stored = 0.5 * PAPER.bellows_stiffness * ((rest - previous.length_change) ** 2 - rest**2)
    assert start.cable_force == pytest.approx(PAPER.bellows_stiffness * rest)
    assert work - stored > dissipated > 0.5 * (work - stored)


def test_loose_fins_do_not_carry_the_robot_away():
    plant = make_plant(DRY, ROUGH)
    states = gait(0.07, 0.2, plant, cycles=3, law=LOOSE)
    centre = [sum(plant.positions(state)) / 2 for state in states]
    assert max(centre) - min(centre) < PAPER.pitch


def test_the_slack_comes_back_after_a_rest():
    plant = make_plant(DRY, ROUGH)
    state = gait(0.07, 0.2, plant, cycles=1)[-1]
    assert state.length_change == pytest.approx(-PAPER.gain * PAPER.slack, abs=1e-3)
    for _ in range(3000):
        state = plant.step(state, 0.0, (FORWARD, FORWARD))
    assert state.length_change == pytest.approx(0.0, abs=1e-5)


def test_the_scatter_comes_from_the_seed():
    assert make_grooves(PAPER, ROUGH, 3) == make_grooves(PAPER, ROUGH, 3)
    grooves = make_grooves(PAPER, ROUGH, 4)
    assert grooves != make_grooves(PAPER, ROUGH, 3)
    mean = sum(grooves.thresholds) / len(grooves.thresholds)
    assert mean == pytest.approx(PAPER.switching_threshold, abs=5e-5)
    assert max(grooves.thresholds) - min(grooves.thresholds) > 4e-4
