# SPDX-License-Identifier: Apache-2.0
"""Batches of any shape return the results of single gaits."""

from dataclasses import fields

import numpy as np
import pytest
from random_cases import random_case, random_loaded_case

from worm_model.gait import Gait, GaitError
from worm_model.parameters import KEYS, PAPER, ParameterError
from worm_model.simulation.batch import CHUNK, evaluate_gaits, sample_cycle
from worm_model.simulation.simulator import evaluate_gait, simulate


@pytest.mark.parametrize("one_sided", [False, True])
def test_batch_equals_single_gaits(one_sided: bool) -> None:
    cases = [random_loaded_case(seed) for seed in range(30)]
    table = evaluate_gaits(
        **{row.name: [getattr(g, row.name) for _, g, _ in cases] for row in fields(Gait)},
        parameters=PAPER.replace(one_sided_cable=one_sided),
        overrides={key: np.array([getattr(p, key) for _, _, p in cases]) for key in KEYS},
    )
    for k, (_, gait, parameters) in enumerate(cases):
        single = evaluate_gait(gait, parameters.replace(one_sided_cable=one_sided))
        for name in ("speed", "power", "cost_of_transport", "grooves_per_cycle", "min_grooves"):
            assert getattr(table, name)[k] == getattr(single, name), name
        assert table.switches[k] == single.switches
        assert table.groove_phase[k] == pytest.approx(single.groove_phase, abs=1e-15)


def test_a_cycle_that_begins_like_the_one_before_is_that_one_again() -> None:
    """Some cycles of a gait are not simulated; its metrics are those of its whole trajectory."""
    for seed in range(30):
        _, gait, parameters = random_case(seed)
        result, cycles = evaluate_gait(gait, parameters, cycles=12, averaged=10), 12
        run = simulate(gait, parameters, cycles)
        ends = run.at(np.array([2, cycles]) * gait.period)
        assert result.speed * 10 * gait.period == pytest.approx(
            gait.direction * (ends.x1[1] - ends.x1[0]), rel=1e-11, abs=1e-12
        )
        work = ends.energy[1] - ends.energy[0]
        assert result.power * 10 * gait.period == pytest.approx(work, rel=1e-11)
        assert result.switches == sum(event.switched for event in run.events())


def test_a_cycle_of_many_gaits_is_that_of_each() -> None:
    stroke, frequency, phases = np.array([0.05, 0.07]), np.array([0.1, 0.3]), np.arange(20) / 20
    force, power = sample_cycle(stroke, frequency, -1, PAPER, 2, phases)
    for k in range(2):
        gait = Gait(stroke[k], frequency[k], -1)
        alone = simulate(gait).at((2 + phases) * gait.period)
        assert force[k] == pytest.approx(alone.cable_force, rel=1e-9)
        assert power[k] == pytest.approx(alone.power, rel=1e-9)
    both = sample_cycle(stroke, frequency, -1, PAPER, 2, np.stack([phases, phases**2]))[0]
    assert np.array_equal(both[0], force[0])
    squared = sample_cycle(stroke[1:], frequency[1:], -1, PAPER, 2, phases**2)[0]
    assert np.array_equal(both[1], squared[0])


def test_shapes_broadcast_and_progress_reaches_one() -> None:
    seen: list[float] = []
    table = evaluate_gaits(
        np.linspace(0.01, 0.09, 30)[:, np.newaxis], np.linspace(0.08, 0.4, 20), progress=seen.append
    )
    assert table.speed.shape == (30, 20)
    assert len(seen) == -(-600 // CHUNK)
    assert seen[-1] == 1.0
    for overrides in ({}, {"gain": 0.85}, {"gain": []}):
        assert evaluate_gaits([], 0.2, overrides=overrides).speed.shape == (0,)


def test_an_exception_of_the_progress_cancels() -> None:
    calls = []

    def stop(fraction: float) -> None:
        calls.append(fraction)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        evaluate_gaits(np.full(20 * CHUNK, 0.07), 0.2, progress=stop)
    assert len(calls) == 1


def test_bad_rows_are_rejected() -> None:
    with pytest.raises(GaitError, match="stroke"):
        evaluate_gaits([0.07, -0.07], 0.2)
    with pytest.raises(GaitError, match=r"0\.31 m"):
        evaluate_gaits(0.25, 0.1, pretension=0.06)
    for direction in ([1, 2, 1], [-1, 0, 1]):
        with pytest.raises(GaitError, match="direction"):
            evaluate_gaits([0.07, 0.07, 0.07], 0.2, direction=direction)
    with pytest.raises(ValueError, match="finite"):
        evaluate_gaits([0.07, np.nan], 0.2)
    for field in ({"pretension": -1e-3}, {"contraction_share": 0.0}, {"ramp_share": 0.09}):
        with pytest.raises(GaitError, match=next(iter(field))):
            evaluate_gaits([0.07, 0.07], 0.2, **field)
    with pytest.raises(ParameterError, match="no such parameter"):
        evaluate_gaits(0.07, 0.2, overrides={"pich": 0.017})
    with pytest.raises(ParameterError, match="switch back"):
        evaluate_gaits(
            0.07, 0.2, overrides={"switching_threshold": [0.0175, 0.009], "pitch": [0.017, 0.019]}
        )
    with pytest.raises(ValueError, match="cannot be averaged"):
        evaluate_gaits(0.07, 0.2, cycles=2, averaged=3)
