# SPDX-License-Identifier: Apache-2.0
"""Status and rest pose of the twin, and the colours of the fins."""

import math

import numpy as np
import pytest
from twin_samples import CommandedLength, GaitSample, TrackerSample, follow, rows_of

from worm_model.gait import REVERSE, Gait
from worm_model.parameters import KEYS, NOT_OF_PAPER, PAPER
from worm_model.run import Activity
from worm_model.twin.data.records import Health, Severity
from worm_model.twin.scene import FREE, HOLDING, YIELDING, engagement
from worm_model.twin.signatures import HEALTHY_SPREAD
from worm_model.twin.twin import Twin
from worm_model.twin.twin_status import position_deviation, report

GAIT = Gait(0.08, 0.2)
ONSET = 10**18
START = GaitSample(ONSET, Activity.RUNNING, GAIT, ONSET)


def rest(length: float) -> list[TrackerSample]:
    times = np.arange(40, 0, -1) / 30
    return [TrackerSample(ONSET - round(t * 1e9), 0.5, 0.5 + length) for t in times]


def test_a_twin_without_input_does_not_call_itself_well():
    twin = Twin()
    moves = [
        CommandedLength(ONSET + round(t * 1e9), GAIT.command(t)) for t in np.arange(1, 51) * 0.01
    ]
    seen = [TrackerSample(ONSET + round(t * 1e9), 0.5, 0.7952) for t in np.arange(1, 10) / 30]
    samples = [*rest(0.2952), START, *sorted(moves + seen, key=lambda s: s.stamp_ns)]
    state = twin.start()
    newest = twin.advance(state, rows_of(samples), to_the_end=True).residuals[-1]
    assert report(state, newest, 0.5).level is Severity.INFO
    assert "state of the fins is unknown" in report(state, newest, 0.5).message
    state.record["start_known"], newest["health"] = 1, Health.HEALTHY
    assert "as expected" in report(state, newest, 0.5).message
    assert report(twin.start(), None).message == "no length yet"
    assert math.isnan(position_deviation(state, None))
    state.record["noise_square"][0], newest["rear_position_scale"] = 0.004**2, 0.003
    newest["position_size"] = 2.0
    assert position_deviation(state, newest) == pytest.approx(0.01)
    newest["stamp_ns"] -= 6_000_000_000
    assert math.isnan(position_deviation(state, newest))
    silent = report(state, newest, 3.2)
    assert silent.level is Severity.WARNING
    assert silent.message.startswith("no input for 3 s")


def test_fins_are_coloured_by_what_they_do():
    assert engagement(0.0, PAPER, 1) is FREE
    assert engagement(-0.005, PAPER, 1) is HOLDING
    assert engagement(0.005, PAPER, 1) is YIELDING
    assert engagement(0.005, PAPER, REVERSE) is HOLDING


def test_the_tracker_gives_the_length_where_nothing_else_does():
    twin = Twin()
    state = twin.start()
    output = follow([*rest(0.297), START], twin, state=state)
    assert state.initial_length == pytest.approx(0.297)
    assert output.states[-1].rear_position == pytest.approx(0.5)
    assert output.states[-1].groove_phase == pytest.approx(0.297 - 17 * PAPER.pitch)


def test_each_parameter_has_a_spread_or_is_known():
    """A new parameter without one would count as exact when the twin weighs the causes."""
    measured = {"rear_mass", "front_mass", "unstressed_length", "pitch"}  # with scale and ruler
    assert {*HEALTHY_SPREAD, "initial_length", *measured, *NOT_OF_PAPER} == set(KEYS)
