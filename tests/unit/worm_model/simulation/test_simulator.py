# SPDX-License-Identifier: Apache-2.0
"""Invariants for any admissible parameters, and limits with a closed form."""

import dataclasses
import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, reject
from hypothesis import strategies as st
from random_cases import examples, random_case

from worm_model.gait import FORWARD, REVERSE, Gait
from worm_model.parameters import PAPER, ParameterError, Parameters
from worm_model.simulation.closed_form import front_groove, groove_phase
from worm_model.simulation.simulator import (
    Locomotion,
    Motions,
    SimulationError,
    evaluate_gait,
    play_gait,
    simulate,
)

seeds = st.integers(0, 2**32 - 1)
few = examples(40)


def crawling_case(seed: int) -> tuple[str, Gait, Parameters]:
    """Return a random case. Reject the rare robot (no clearance, p_sw > pitch) whose anchors switch without end."""
    kind, gait, parameters = random_case(seed)
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
@given(seeds)
def test_mirrored_robot_mirrors_its_motion(seed: int) -> None:
    _, gait, parameters = crawling_case(seed)
    mirrored = parameters.replace(rear_mass=parameters.front_mass, front_mass=parameters.rear_mass)
    times, changes = sampled_length(gait, parameters)
    forward = Locomotion(parameters, FORWARD, gait.margin)
    reverse = Locomotion(mirrored, REVERSE, gait.margin)
    _, ahead = forward.follow(forward.start(), times, changes)
    _, back = reverse.follow(reverse.start(x1=-groove_phase(parameters)), times, changes)
    lattice = front_groove(parameters) * parameters.pitch
    assert back.x1 == pytest.approx(lattice - ahead.x2, abs=1e-9)
    assert back.front_force == pytest.approx(-ahead.rear_force, abs=1e-5)


@few
@given(seeds, st.floats(0.0, 5000.0))
def test_bellows_damping_never_changes_the_motion(seed: int, damping: float) -> None:
    _, gait, parameters = crawling_case(seed)
    times = np.linspace(0.0, 2.0 * gait.period, 50)
    one = simulate(gait, parameters, cycles=2).at(times)
    other = simulate(gait, parameters.replace(bellows_damping=damping), cycles=2).at(times)
    assert np.array_equal(one.rear_anchor, other.rear_anchor)
    assert one.x1 == pytest.approx(other.x1, abs=1e-12)


@few
@given(seeds, st.floats(0.0, 0.006))
def test_margin_is_a_shifted_threshold(seed: int, margin: float) -> None:
    _, gait, parameters = crawling_case(seed)
    robust = evaluate_gait(dataclasses.replace(gait, margin=margin), parameters)
    threshold = parameters.switching_threshold + margin
    shifted = evaluate_gait(
        dataclasses.replace(gait, margin=0.0), parameters.replace(switching_threshold=threshold)
    )
    assert robust.speed == shifted.speed
    assert robust.power == shifted.power
    assert robust.switches == shifted.switches


def stored_energy(motions: Motions, parameters: Parameters, direction: int) -> np.ndarray:
    """Return kinetic energy plus the energy of bellows and fins, J."""
    stretch = motions.length - parameters.unstressed_length
    energy = 0.5 * parameters.bellows_stiffness * stretch**2
    energy += 0.5 * parameters.rear_mass * motions.v1**2
    energy += 0.5 * parameters.front_mass * motions.v2**2
    for force in (motions.rear_force, motions.front_force):
        # below its clearance (force < 0) a fin is engaged in a forward gait
        engaged = (force < 0.0) == (direction == FORWARD)
        stiffness = np.where(engaged, parameters.engaged_stiffness, parameters.disengaged_stiffness)
        energy += 0.5 * force**2 / stiffness
    return energy


@few
@given(seeds)
def test_energy_balance_between_switches(seed: int) -> None:
    _, gait, parameters = crawling_case(seed)
    trajectory = simulate(gait, parameters, cycles=2)
    switches = [event.time for event in trajectory.events() if event.switched]
    edges = np.array([0.0, *switches, trajectory.duration])
    widest = int(np.argmax(np.diff(edges)))
    start, end = edges[widest] + 1e-9, edges[widest + 1]
    inside = [e.time for e in trajectory.events() if start < e.time < end]
    nodes, weights = np.polynomial.legendre.leggauss(24)
    lost = worked = 0.0
    borders = np.unique(
        np.concatenate([np.linspace(start, end, 200), inside, _clip_times(gait, parameters)])
    )
    borders = borders[(borders >= start) & (borders <= end)]
    for low, high in pairwise(borders):
        middle, half = 0.5 * (low + high), 0.5 * (high - low)
        m = trajectory.at(middle + half * nodes)
        loss = parameters.bellows_damping * m.length_rate**2
        loss = loss + parameters.viscous_friction * (m.v1**2 + m.v2**2)
        lost += half * float(weights @ loss)
        worked += half * float(weights @ (-m.cable_force * m.length_rate))
    before, after = stored_energy(trajectory.at([start, end]), parameters, gait.direction)
    assert after - before == pytest.approx(worked - lost, rel=1e-6, abs=1e-8)


def _clip_times(gait: Gait, parameters: Parameters) -> list[float]:
    if gait.stroke <= parameters.slack:
        return []
    opening = math.acos(1.0 - 2.0 * parameters.slack / gait.stroke) / (2.0 * math.pi)
    phases = [k + sign * opening for k in range(3) for sign in (-1, 1)]
    return [phase * gait.period for phase in phases]


@few
@given(seeds)
def test_anchors_stay_on_the_lattice_and_within_the_threshold(seed: int) -> None:
    _, gait, parameters = crawling_case(seed)
    trajectory = simulate(gait, parameters)
    m = trajectory.at(np.linspace(0.0, trajectory.duration, 300))
    limit = parameters.switching_threshold + gait.margin + 1e-12
    for position, anchor in ((m.x1, m.rear_anchor), (m.x2, m.front_anchor)):
        grooves = anchor / parameters.pitch
        assert grooves == pytest.approx(np.round(grooves), abs=1e-9)
        assert np.all(np.abs(position - anchor) <= limit)


@few
@given(seeds, st.integers(1, 398))
def test_splitting_an_interval_changes_nothing(seed: int, at: int) -> None:
    _, gait, parameters = crawling_case(seed)
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
    for times in ([-0.1, 0.2], [0.2, 0.1]):
        with pytest.raises(ValueError, match="ascend"):
            play_gait(Gait(0.07, 0.2), PAPER, model.start(), times)


def test_no_time_changes_nothing_but_is_sampled() -> None:
    model = Locomotion()
    before, _ = model.follow(model.start(), [0.1], [-0.002])
    after, motions = model.follow(before, [0.1, 0.1], [-0.002, -0.002])
    assert after == before
    assert motions.x1 == pytest.approx(model.x1(before), abs=1e-15)
    assert motions.length == pytest.approx(PAPER.initial_length - 0.002)


def test_no_samples_leave_the_state_as_it_is() -> None:
    model = Locomotion()
    before, _ = model.follow(model.start(), [0.1], [-0.002])
    after, motions = model.follow(before, [], [])
    assert after == before
    assert motions.x1.shape == motions.energy.shape == (0,)
    with pytest.raises(ValueError, match="a piece has two borders"):
        model.follow(before, [], [-0.002])
