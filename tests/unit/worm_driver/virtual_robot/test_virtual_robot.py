# SPDX-License-Identifier: Apache-2.0
"""The whole virtual robot on a virtual clock: it is reproducible, it moves forward, its instruments are correct."""

import math
from dataclasses import replace
from itertools import pairwise
from random import Random

import numpy as np
import pytest

from worm_driver.virtual_robot.offline_run import run_offline
from worm_driver.virtual_robot.virtual_robot import Tracker, VirtualRobot
from worm_driver.virtual_robot.virtual_settings import TrackerSettings
from worm_driver.virtual_robot.wire.faults import make_fault
from worm_msgs.gait import FORWARD, REVERSE, Gait, Profile


def grooves_per_cycle(run, frequency, pitch=0.0173, cycles=5, last=3):
    def position(time):
        near = np.abs(run.tracker_time - time) < 0.06
        return np.nanmean(run.rear_position[near])

    end = run.onset + cycles / frequency
    return (position(end) - position(end - last / frequency)) / pitch / last


@pytest.mark.parametrize(
    ("stroke", "frequency", "direction", "grooves"),
    [(0.07, 0.2, FORWARD, 1), (0.0762, 0.2325, FORWARD, 2), (0.07, 0.2, REVERSE, -1)],
)
def test_robust_gaits_gain_the_predicted_grooves(settings, stroke, frequency, direction, grooves):
    change = Gait(stroke, frequency).length_change
    run = run_offline(settings, change, 5 / frequency, rest=0.5, direction=direction)
    assert grooves_per_cycle(run, frequency) == pytest.approx(grooves, abs=0.1)


def test_a_shaped_gait_rests_at_its_pretension_and_walks(settings):
    gait = Gait(0.07, 0.147, 1, 0.0, 0.01, 0.62, Profile.TRAPEZOID, 0.15)
    run = run_offline(settings, gait.length_change, 5 / gait.frequency, rest=3.0)
    metres = 2 * math.pi / 4096 * settings.cable_servos[0].spool_radius
    resting = (run.servo_time > 2.0) & (run.servo_time <= 3.0)
    assert run.goal_ticks[resting] * metres == pytest.approx(0.01, abs=metres)
    assert run.goal_ticks.max() * metres == pytest.approx(gait.reach, abs=2 * metres)
    assert grooves_per_cycle(run, gait.frequency) == pytest.approx(2, abs=0.1)


def test_a_rehearsal_repeats_exactly_and_differs_with_the_seed(settings):
    first, again, other = (
        run_offline(replace(settings, seed=seed), Gait(0.07, 0.2).length_change, 2.0)
        for seed in (5, 5, 6)
    )
    for name in ("goal_ticks", "encoder_ticks", "current", "bus_voltage"):
        assert np.array_equal(getattr(first, name), getattr(again, name))
    assert np.array_equal(first.rear_position, again.rear_position, equal_nan=True)
    assert not np.array_equal(first.current, other.current)


def test_the_spread_changes_the_true_values_but_not_the_ruler_readings(settings):
    spread = replace(settings, parameter_spread=0.05)
    truths = [
        run_offline(replace(spread, seed=seed), Gait(0.07, 0.2).length_change, 0.1, rest=0.1).truth
        for seed in range(5)
    ]
    assert len({truth.bellows_stiffness for truth in truths}) == 5
    assert {truth.pitch for truth in truths} == {settings.body.pitch}


def test_what_the_instruments_of_a_rehearsal_see(settings):
    run = run_offline(settings, Gait(0.07, 0.2).length_change, 10.0)
    resting = run.power_time < run.onset
    idle = np.mean((run.bus_voltage * run.current)[resting])
    assert idle == pytest.approx(settings.body.idle_power, rel=0.02)
    assert np.max(run.bus_voltage * run.current) > 5.0
    assert np.median(np.diff(run.tracker_time)) == pytest.approx(1 / 30, abs=1e-3)
    assert np.nanstd(run.rear_position[run.tracker_time < run.onset]) == pytest.approx(
        settings.tracker.noise, rel=0.3
    )
    # Half a stroke of 70 mm on a spool of 25 mm, with the servo slightly behind its goal.
    assert np.max(run.goal_ticks) == round(0.07 / 0.025 * 4096 / (2 * math.pi))
    error = run.goal_ticks - run.encoder_ticks
    assert 5 < np.max(error) < 100


def test_a_robot_that_is_put_back_is_where_it_started_and_runs_as_before(settings):
    robot = VirtualRobot(settings)
    start = robot.plant.positions(robot.state)
    robot.state = robot.state._replace(centre=0.123, rear_groove=7, front_groove=24)
    robot.board.add(make_fault("put_back", start=0.01))
    robot.advance(1.0)
    assert robot.plant.positions(robot.state) == pytest.approx(start, abs=1e-6)
    plain = VirtualRobot(settings)
    assert (robot.state.rear_groove, robot.state.front_groove) == plain.state[4:6]


def test_a_fin_pair_of_two_servos_has_to_agree(settings):
    rear, front = settings.fin_servos
    second = replace(rear, id=13, start_angle=rear.reverse_angle)
    robot = VirtualRobot(replace(settings, fin_servos=(rear, second, front)))
    assert robot.laws == (0, FORWARD)


def test_two_cable_servos_of_opposite_signs_share_the_cable(settings):
    (first,) = settings.cable_servos
    second = replace(first, id=2, sign=-1)
    robot = VirtualRobot(replace(settings, cable_servos=(first, second)))
    for servo, sign in zip(robot.servos, (1, -1), strict=False):
        servo.write(64, b"\x01")  # the torque
        goal = servo.memory["goal_position"] + sign * 1000
        servo.write(116, goal.to_bytes(4, "little", signed=True))
    robot.advance(2.0)
    wound = 1000 / 4096 * 2 * math.pi * first.spool_radius
    assert robot.cable_change == pytest.approx(-wound, abs=1e-4)
    loads = [servo.load for servo in robot.servos[:2]]
    assert loads[0] == pytest.approx(-loads[1])
    assert loads[0] > 0.1


def test_an_occlusion_hides_one_marker_for_its_time():
    given = TrackerSettings(rate=30.0, noise=0.00015, occlusion_rate=0.2, occlusion=0.3)
    tracker = Tracker(given, Random(1))
    samples = [tracker.expose(index / 30, 0.1, 0.4) for index in range(200 * 30)]
    hidden = [math.isnan(sample.rear_position) for sample in samples]
    starts = sum(now and not before for before, now in pairwise(hidden))
    assert starts == pytest.approx(0.2 * 200, rel=0.4)
    assert sum(hidden) / starts == pytest.approx(0.3 * 30, rel=0.25)
    both = sum(
        math.isnan(sample.rear_position) and math.isnan(sample.front_position) for sample in samples
    )
    assert both < 0.5 * sum(hidden)
