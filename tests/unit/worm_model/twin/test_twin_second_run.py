# SPDX-License-Identifier: Apache-2.0
"""A second run in one session, compared with the virtual robot's plant, which is independent of the twin."""

import dataclasses
import math
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from twin_samples import (
    CommandedLength,
    GaitSample,
    MeasuredLength,
    TrackerSample,
    TwinOutput,
    at,
    follow,
)

from worm_driver.virtual_robot.plant import Plant, PlantEffects, make_grooves
from worm_model.gait import FORWARD, REVERSE, Gait
from worm_model.parameters import PAPER
from worm_model.run import Activity
from worm_model.twin.data.records import Health
from worm_msgs.robot_parameters import RobotParameters

CYCLES, PAUSE_S, STEP_S, ORIGIN = 3, 6.0, 1e-3, 0.4
FIRST = Gait(0.07, 0.2)


@lru_cache
def session(second: Gait, release_s: float = 0.5) -> list:
    """Return the samples of driver and camera for two runs with a rest in between, from the onset of the first.

    The transmission returns its slack when the cable has rested for ``release_s``.
    """
    body = RobotParameters(
        **{f.name: getattr(PAPER, f.name) for f in dataclasses.fields(RobotParameters)}
    )
    effects = PlantEffects(0.0, 0.0, 1e-4, release_s)
    grooves = make_grooves(body, effects, 0)
    plant = Plant(body, effects, grooves, grooves, STEP_S)
    state = plant.at_rest()
    end = CYCLES * FIRST.period
    again = end + PAUSE_S
    samples = [
        GaitSample(at(-1.5), Activity.RESTING),
        GaitSample(at(0), Activity.RUNNING, FIRST, at(0)),
    ]
    for k in range(-2000, round((again + CYCLES * second.period) / STEP_S) + 1):
        time = k * STEP_S
        command, laws = 0.0, (FORWARD, FORWARD)
        if 0.0 < time < end:
            command = FIRST.command(time)
        elif end + 3.0 < time <= end + 3.2:
            laws = (0, 0) if second.direction == REVERSE else laws
        elif time > end + 3.2:
            laws = (second.direction, second.direction)
            command = second.command(time - again) if time > again else 0.0
        state = plant.step(state, command, laws)
        if k % 10 == 0:
            samples.append(CommandedLength(at(time), command))
        if k % 33 == 0:
            rear, front = plant.positions(state)
            samples.append(TrackerSample(at(time), ORIGIN + rear, ORIGIN + front))
            samples.append(MeasuredLength(at(time), front - rear))
    samples += [
        GaitSample(at(end + 0.003), Activity.IDLE),
        GaitSample(at(again - 1.5), Activity.RESTING),
        GaitSample(at(again), Activity.RUNNING, second, at(again)),
    ]
    return sorted(samples, key=lambda sample: sample.stamp_ns)


def positions(samples: list) -> tuple[float, TwinOutput]:
    """Return the twin's estimate of the rear module's displacement, and all its output."""
    output = follow(samples)
    return output.states[-1].rear_position - output.states[0].rear_position, output


@pytest.mark.parametrize("second", [FIRST, Gait(0.08, 0.2), Gait(0.07, 0.2, REVERSE)])
def test_the_command_alone_predicts_where_a_second_run_ends(second):
    samples = session(second)
    seen = [s.rear_position for s in samples if isinstance(s, TrackerSample)]
    moved, output = positions([s for s in samples if isinstance(s, CommandedLength | GaitSample)])
    assert moved == pytest.approx(seen[-1] - seen[0], abs=1.5e-3)
    start = [s for s in output.states if s.energy == 0.0][-1]
    assert start.stamp_ns == at(CYCLES * FIRST.period + PAUSE_S)
    assert (start.rear_groove, start.front_groove) == (0, 0)


@pytest.mark.parametrize("second", [FIRST, Gait(0.07, 0.2, REVERSE)])
@pytest.mark.parametrize("carried_mm", [0.0, 1000.0 * PAPER.pitch])
def test_a_camera_confirms_the_twin_through_a_second_run(second, carried_mm):
    samples = session(second)
    again = at(CYCLES * FIRST.period + PAUSE_S)
    shift = 1e-3 * carried_mm
    samples = [
        replace(s, rear_position=s.rear_position + shift, front_position=s.front_position + shift)
        if isinstance(s, TrackerSample) and s.stamp_ns > again - 2_000_000_000
        else s
        for s in samples
    ]
    _, output = positions(samples)
    residuals = [
        r.rear_position
        for r in output.residuals
        if r.stamp_ns > again and math.isfinite(r.rear_position)
    ]
    assert len(residuals) > 100
    assert max(np.abs(residuals)) < 1.5e-3
    assert not any("the robot was moved" in n.text for n in output.notices)


@pytest.mark.parametrize("second", [FIRST, Gait(0.08, 0.2)])
def test_slack_that_is_still_being_taken_up_is_not_another_l0(second):
    samples = session(second, release_s=100.0)
    again = at(CYCLES * FIRST.period + PAUSE_S)
    _, output = positions(samples)
    assert any("the slack is still taken up" in n.text for n in output.notices)
    later = [s for s in output.states if s.stamp_ns > again]
    off = [s.initial_length - PAPER.initial_length for s in later]
    assert max(np.abs(off)) < 1e-4
    rows = [r for r in output.residuals if r.stamp_ns > again + 1_000_000_000]
    assert max(abs(r.length) for r in rows if math.isfinite(r.length)) < 1.5e-3
    assert max(abs(r.rear_position) for r in rows if math.isfinite(r.rear_position)) < 1.5e-3


def test_the_slack_that_returns_after_a_run_leaves_the_robot_healthy():
    """The body grows by 7 mm at a constant command, and the twin continues to publish its agreement with the run."""
    rows = follow(session(Gait(0.07, 0.2))).residuals
    end = at(CYCLES * FIRST.period)
    rest = [row for row in rows if end + 10**9 < row.stamp_ns < at(CYCLES * FIRST.period + PAUSE_S)]
    assert len(rest) > 50
    assert {row.health for row in rest} <= {Health.HEALTHY, Health.UNKNOWN}
