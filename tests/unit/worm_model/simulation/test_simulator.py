# SPDX-License-Identifier: Apache-2.0
"""Invariants for any admissible parameters, and limits with a closed form."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, reject
from hypothesis import strategies as st
from random_cases import examples, random_case, random_dry_case

from worm_model.gait import Gait
from worm_model.parameters import PAPER, ParameterError, Parameters
from worm_model.simulation.simulator import (
    Locomotion,
    SimulationError,
    evaluate_gait,
    simulate,
)

seeds = st.integers(0, 2**32 - 1)
few = examples(40)


def crawling_case(seed: int, make=random_case) -> tuple[str, Gait, Parameters]:
    """Return a random case. Reject the rare robot (no clearance, p_sw > pitch) whose anchors switch without end."""
    kind, gait, parameters = make(seed)
    try:
        simulate(gait, parameters).events()
    except SimulationError:
        assert parameters.clearance == 0.0
        assert parameters.switching_threshold > parameters.pitch
        reject()
    return kind, gait, parameters


def sampled_length(gait: Gait, parameters: Parameters, count: int = 400) -> tuple:
    times = np.linspace(0.0, 3.0 * gait.period, count)
    motions = simulate(gait, parameters).at(times)
    return times[1:], motions.length[1:] - parameters.initial_length


@few
@given(seeds, st.integers(1, 398), st.sampled_from([random_case, random_dry_case]))
def test_splitting_an_interval_changes_nothing(seed: int, at: int, make) -> None:
    """With dry friction, the model decides again at the start of each part which module sticks."""
    _, gait, parameters = crawling_case(seed, make)
    times, changes = sampled_length(gait, parameters)
    model = Locomotion(parameters, gait.direction, gait.margin)
    whole, _ = model.follow(model.start(), times, changes)
    half, _ = model.follow(model.start(), times[:at], changes[:at])
    rest, _ = model.follow(half, times[at:], changes[at:])
    assert rest.y == pytest.approx(whole.y, abs=1e-12)
    assert rest.y_rate == pytest.approx(whole.y_rate, abs=1e-9)
    assert dataclasses.replace(rest, y=0.0, y_rate=0.0) == dataclasses.replace(
        whole, y=0.0, y_rate=0.0
    )


@few
@given(seeds)
def test_a_finely_sampled_gait_gives_the_gaits_motion(seed: int) -> None:
    _, gait, parameters = crawling_case(seed)
    times = np.linspace(0.0, 2.0 * gait.period, 4001)
    exact = simulate(gait, parameters, cycles=2).at(times)
    model = Locomotion(parameters, gait.direction, gait.margin)
    start = dataclasses.replace(
        model.start(), y_rate=parameters.front_mass / parameters.mass * float(exact.length_rate[0])
    )
    _, sampled = model.follow(start, times[1:], exact.length[1:] - parameters.initial_length)
    same = sampled.rear_anchor == exact.rear_anchor[1:]
    same &= sampled.front_anchor == exact.front_anchor[1:]
    assert same.mean() > 0.98  # exactly at the threshold, interpolation decides
    first = len(same) if same.all() else int(np.argmin(same))
    assert sampled.x1[:first] == pytest.approx(exact.x1[1:][:first], abs=2e-5)


def test_a_stroke_within_the_slack_moves_nothing() -> None:
    result = evaluate_gait(Gait(0.008, 0.2))
    assert result.speed == 0.0
    assert result.power == pytest.approx(PAPER.idle_power)
    assert result.switches == 0
    assert result.cost_of_transport == math.inf


def test_parameters_that_would_chatter_are_rejected() -> None:
    with pytest.raises(ParameterError, match="switch back at once"):
        PAPER.replace(switching_threshold=0.4999 * PAPER.pitch)
    gait = Gait(0.07, 0.2)
    result = evaluate_gait(gait, PAPER.replace(switching_threshold=0.5 * PAPER.pitch))
    assert math.isfinite(result.speed)


def test_times_outside_the_run_are_rejected() -> None:
    trajectory = simulate(Gait(0.07, 0.2))
    with pytest.raises(ValueError, match="ascend within 0 to 25 s"):
        trajectory.at([0.0, 26.0])
    with pytest.raises(ValueError, match="ascend"):
        trajectory.at([1.0, 0.5])
    assert trajectory.at([]).x1.shape == (0,)
    model = Locomotion()
    with pytest.raises(ValueError, match="must be finite"):
        model.follow(model.start(), [0.1, 0.2], [-0.001, math.nan])


def test_no_time_changes_nothing_but_is_sampled() -> None:
    model = Locomotion()
    before, _ = model.follow(model.start(), [0.1], [-0.002])
    for times in ([0.1, 0.1], []):
        after, motions = model.follow(before, times, [-0.002] * len(times))
        assert after == before
        assert motions.x1 == pytest.approx([model.x1(before)] * len(times), abs=1e-15)
        assert motions.length == pytest.approx([PAPER.initial_length - 0.002] * len(times))
    with pytest.raises(ValueError, match="a piece has two borders"):
        model.follow(before, [], [-0.002])
