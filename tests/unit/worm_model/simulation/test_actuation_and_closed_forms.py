# SPDX-License-Identifier: Apache-2.0
"""The actuation model and the closed forms of the slow limit."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from random_cases import examples

from worm_model.gait import Gait
from worm_model.parameters import KEYS, PAPER, POWER_ONLY
from worm_model.simulation import actuation
from worm_model.simulation.batch import evaluate_gaits
from worm_model.simulation.closed_form import (
    cliff_margin,
    groove_phase,
    grooves_per_cycle,
    largest_load,
)

# The slow limit has no inertia and no viscous friction, and neglects dry friction.
FAST_ONLY = {
    *("rear_mass", "front_mass", "viscous_friction"),
    *("rear_dry_friction", "front_dry_friction"),
}


def test_each_parameter_affects_the_closed_forms_or_is_known_not_to() -> None:
    gait, loaded = Gait(0.07, 0.2, pretension=0.004), PAPER.replace(rear_load=0.1, front_load=0.1)

    def forms(key: str, factor: float) -> tuple[float, ...]:
        value = factor * getattr(loaded, key) if getattr(loaded, key) else factor - 1.0
        changed = loaded.replace(**{key: value})
        return groove_phase(changed), cliff_margin(changed), largest_load(gait, changed)

    without = {key for key in KEYS if forms(key, 1.0) == forms(key, 1.001)}
    assert without == FAST_ONLY | POWER_ONLY


def test_step_and_ramp_of_a_sampled_command_have_their_closed_form() -> None:
    times = np.array([0.0, 0.1, 0.25, 1.0])
    step = actuation.length_change_of_command(times, np.full(4, -0.05), PAPER)
    target = -0.05 * PAPER.gain
    assert step == pytest.approx(target * (1.0 - np.exp(-times / PAPER.time_constant)))
    ramp = actuation.length_change_of_command(times, -0.01 - 0.04 * times, PAPER)
    rate, offset = -0.04 * PAPER.gain, -0.01 * PAPER.gain
    lag = rate * PAPER.time_constant
    decay = np.exp(-times / PAPER.time_constant)
    assert ramp == pytest.approx(offset + rate * times - lag + (lag - offset) * decay)


@examples(30)
@given(
    st.lists(st.tuples(st.floats(0.001, 1.0), st.floats(-0.09, 0.0)), min_size=2, max_size=12),
    st.lists(st.floats(0.0, 10.0), min_size=1, max_size=9),
    st.floats(0.0, 1.0),
)
def test_where_one_looks_does_not_change_the_answer(
    ramps: list[tuple[float, float]], looks: list[float], engaged: float
) -> None:
    times = np.cumsum([duration for duration, _ in ramps])
    commands = np.array([command for _, command in ramps])
    at = np.sort(np.array(looks))
    found = actuation.length_change_of_command(times, commands, PAPER, at=at, engaged=engaged)
    merged = np.sort(np.concatenate([times, at, [engaged]]))
    split = actuation.length_change_of_command(
        merged, np.interp(merged, times, commands), PAPER, engaged=engaged
    )
    assert found == pytest.approx(np.interp(at, merged, split), abs=1e-12)
    assert not found[at < engaged].any()


def test_mismatched_samples_are_rejected() -> None:
    with pytest.raises(ValueError, match="equally long"):
        actuation.length_change_of_command([0.0, 1.0], [0.0], PAPER)


def test_groove_phase_lies_in_its_half_open_interval() -> None:
    assert groove_phase(PAPER) == pytest.approx(0.0011)
    half = PAPER.replace(initial_length=17.5 * PAPER.pitch)
    assert groove_phase(half) == pytest.approx(0.5 * PAPER.pitch)
    assert groove_phase(PAPER.replace(initial_length=17 * PAPER.pitch)) == pytest.approx(0.0)


def test_cliff_is_the_notes() -> None:
    assert cliff_margin(PAPER) == pytest.approx(0.0034, abs=5e-5)
    level = PAPER.replace(initial_length=0.3000 - 0.0059)
    assert cliff_margin(level) == pytest.approx(0.0025, abs=5e-5)


@pytest.mark.parametrize(("margin", "phase"), [(0.0, 0.0011), (0.0034, 0.0011), (0.002, -0.004)])
def test_groove_count_matches_the_simulator_over_the_box(margin: float, phase: float) -> None:
    parameters = PAPER.replace(initial_length=17 * PAPER.pitch + phase)
    stroke = np.linspace(0.01, 0.09, 41)[:, np.newaxis]
    frequency = np.linspace(0.08, 0.4, 17)[np.newaxis, :]
    table = evaluate_gaits(stroke, frequency, margin, parameters=parameters)
    simulated = np.round(table.grooves_per_cycle)
    closed = [
        [grooves_per_cycle(Gait(s, f, 1, margin), parameters) for f in frequency[0]]
        for s in stroke[:, 0]
    ]
    assert np.mean(simulated == np.array(closed)) >= 0.98
