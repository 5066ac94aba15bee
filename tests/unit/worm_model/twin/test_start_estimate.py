# SPDX-License-Identifier: Apache-2.0
"""The estimated start of a gait without measured lengths."""

import numpy as np
import pytest
from twin_samples import ONSET, CommandedLength, GaitSample, TrackerSample, at, follow

from worm_model.gait import Gait
from worm_model.parameters import PAPER
from worm_model.run import Activity
from worm_model.simulation.actuation import length_change_of_command, resting_change
from worm_model.simulation.simulator import Locomotion
from worm_model.twin.start_estimate import estimate_start
from worm_model.twin.twin import Twin, TwinState

ORIGIN = 0.5
MODEL = Locomotion(PAPER)


def watched(gait: Gait, offset: float, late: float = 0.0) -> tuple[TwinState, float]:
    """Return the twin's state just before the end of the first cycle, and the true x1 (m) at the onset.

    The fins leave the rear module at most ``offset`` (m) away from its groove. The driver's state arrives ``late`` (s).
    """
    rest = resting_change(gait, PAPER)
    start = MODEL.settled(MODEL.start(-2.0, rest, offset), rest)
    times = np.arange(1, round(99.0 * gait.period)) * 0.01
    commands = np.array([gait.command(time) for time in times])
    knots, values = np.append(0.0, times), np.append(gait.command(0.0), commands)
    changes = length_change_of_command(knots, values, PAPER, rest, at=times)
    motions = MODEL.follow(start, times, changes)[1]
    still = [
        TrackerSample(at(-time), ORIGIN, ORIGIN + PAPER.initial_length + rest)
        for time in times[400:2:-3]
    ]
    shift = ORIGIN - MODEL.x1(start)
    moves = [
        CommandedLength(at(time), command) for time, command in zip(times, commands, strict=True)
    ]
    seen = [
        TrackerSample(at(time), rear + shift, front + shift)
        for time, rear, front in zip(times[::3], motions.x1[::3], motions.x2[::3], strict=True)
    ]
    resting = GaitSample(at(-3.9), Activity.RESTING)
    announced = GaitSample(at(late), Activity.RUNNING, gait, ONSET, run=1, cycle=1)
    samples = sorted([resting, *still, *moves, *seen], key=lambda sample: sample.stamp_ns)
    place = sum(sample.stamp_ns <= announced.stamp_ns for sample in samples)
    twin = Twin()
    state = twin.start()
    follow(
        [*samples[:place], announced, *samples[place:]], twin, chunk=1 if late else 0, state=state
    )
    return state, MODEL.x1(start)


@pytest.mark.parametrize("pretension", [0.0, 0.02])
@pytest.mark.parametrize("late", [0.0, 1.5])
@pytest.mark.parametrize("offset", [0.0, 0.006])
def test_the_length_follows_the_command_from_its_value_at_the_onset(pretension, late, offset):
    state, x1 = watched(Gait(0.06, 0.2, pretension=pretension), offset, late)
    found = estimate_start(state.memory, PAPER, int(state.record["motion_ns"]))
    assert found is not None
    assert found.misfit < 1e-4
    assert found.start.x1 == pytest.approx(x1, abs=2e-4)
