# SPDX-License-Identifier: Apache-2.0
"""From parameters to a served front."""

import dataclasses

import numpy as np
import pytest
from gaits_for_tests import COARSE_MAP, QUICK, cache_in

from worm_model.gait import Gait
from worm_model.parameters import PAPER, ParameterFile
from worm_model.simulation.simulator import evaluate_gait
from worm_optimizer.commands.search_options import gait_table
from worm_optimizer.search.front import (
    load_current,
    load_front,
    make_front,
    nominal_gaits,
    scanned_price,
    store_current,
    thinned,
)
from worm_optimizer.search.gait_map import build_map
from worm_optimizer.search.gait_request import three_gaits
from worm_optimizer.search.optimizer_errors import OptimizerError
from worm_optimizer.search.search_settings import Robustness
from worm_optimizer.search.task import Bounds, MarginTask

FILE = ParameterFile()
GIVEN = dataclasses.replace(QUICK, margin=2e-3)


def ignore(progress) -> None:
    """Who does not listen."""


@pytest.fixture
def cache(tmp_path):
    return cache_in(tmp_path)


def test_the_margin_is_chosen_at_the_cliff_of_the_scan(cache):
    told = []
    front = make_front(FILE, QUICK, 1, cache, told.append)
    assert front.margin == 3e-3  # the scan's step is 1 mm here
    assert front.reason.startswith("at the cliff: beyond it the branch with 2 grooves")
    assert "in closed form it lies at 3.42 mm" in front.reason
    fractions = [progress.fraction for progress in told]
    assert fractions == sorted(fractions)
    assert fractions[-1] == 1.0
    assert [progress.generation for progress in told if progress.generation] == [1, 2, 3, 4, 5, 6]


def test_a_prediction_is_the_simulators(cache):
    front = make_front(FILE, GIVEN, 1, cache, ignore)
    assert 3 <= len(front.predictions) <= QUICK.kept_gaits
    for told in front.predictions:
        robust = evaluate_gait(told.gait, PAPER)
        nominal = evaluate_gait(Gait(told.stroke, told.frequency), PAPER)
        assert told.margin == 2e-3
        assert told.speed == pytest.approx(robust.speed, rel=1e-12)
        assert told.power == pytest.approx(robust.power, rel=1e-12)
        assert told.cost_of_transport == pytest.approx(robust.cost_of_transport, rel=1e-12)
        assert told.nominal_speed == pytest.approx(nominal.speed, rel=1e-12)
        assert told.nominal_power == pytest.approx(nominal.power, rel=1e-12)
        assert told.groove_phase == pytest.approx(0.0011)


def test_past_the_cliff_the_robust_prediction_is_half_of_the_nominal_one(cache):
    """model_notes.md, 14: both are told, so that it can be seen."""
    front = make_front(FILE, dataclasses.replace(QUICK, margin=5e-3), 1, cache, ignore)
    fastest = three_gaits(front.predictions)["max_speed"]
    assert fastest.nominal_grooves_per_cycle == pytest.approx(2.0, abs=1e-3)
    assert fastest.grooves_per_cycle == pytest.approx(1.0, abs=1e-3)


def test_the_same_settings_make_the_same_front_and_find_it_again(cache, tmp_path):
    first = make_front(FILE, GIVEN, 1, cache, ignore)
    second = make_front(FILE, GIVEN, 1, cache_in(tmp_path / "."), ignore)
    assert first == second
    assert load_front(FILE, GIVEN, 1, cache) == first
    assert load_front(ParameterFile(PAPER.replace(slack=0.0081)), GIVEN, 1, cache) is None


def test_with_equal_modules_one_run_serves_both_directions(cache):
    front = make_front(FILE, GIVEN, -1, cache, ignore)
    assert {gait.direction for gait in front.predictions} == {-1}
    forward = load_front(FILE, GIVEN, 1, cache)
    assert forward is not None
    assert forward.mirrored() == front
    assert forward.predictions[0].speed == front.predictions[0].speed > 0.0


def test_with_unequal_modules_each_direction_is_its_own(cache):
    file = ParameterFile(PAPER.replace(front_mass=0.6))
    front = make_front(file, GIVEN, -1, cache, ignore)
    assert {gait.direction for gait in front.predictions} == {-1}
    assert load_front(file, GIVEN, 1, cache) is None
    told = front.predictions[0]
    assert told.power == pytest.approx(evaluate_gait(told.gait, file.parameters).power)


def test_the_front_served_last_is_found_first(cache):
    own = make_front(FILE, GIVEN, 1, cache, ignore)
    assert load_current(FILE, GIVEN, 1, cache) == own
    other = make_front(FILE, dataclasses.replace(QUICK, margin=1e-3), 1, cache, ignore)
    store_current(FILE, GIVEN, other, cache)
    assert load_current(FILE, GIVEN, 1, cache) == other
    assert load_front(FILE, GIVEN, 1, cache) == own


def test_a_scan_is_not_repeated(cache):
    told = []
    first = scanned_price(FILE, QUICK, 1, cache, told.append)
    assert len(told) == 5
    again = scanned_price(FILE, QUICK, -1, cache, told.append)
    assert len(told) == 5
    assert [p.cost_of_transport for p in again.points] == [
        p.cost_of_transport for p in first.points
    ]


def test_any_phase_gaits_carry_the_margin_that_they_stand(cache):
    settings = dataclasses.replace(QUICK, robustness=Robustness.ANY_PHASE)
    front = make_front(FILE, settings, 1, cache, ignore)
    assert front.margin == min(gait.margin for gait in front.predictions) > 1e-3
    assert "at every groove phase; it amounts to margins from" in front.reason
    for gait in front.predictions:
        assert gait.success_probability_any_phase >= 0.8  # the other parameters are uncertain still
        assert gait.nominal_grooves_per_cycle >= gait.grooves_per_cycle - 1e-3


def test_a_slow_map_reports_its_progress_and_can_be_cancelled(cache):
    settings = dataclasses.replace(QUICK, robustness=Robustness.ANY_PHASE)
    told = []
    make_front(FILE, settings, 1, cache, told.append)
    generations = [progress.generation for progress in told]
    before = told[: generations.index(1)]
    assert len(before) >= 5
    assert all(progress.doing.endswith("gaits judged") for progress in before)
    fractions = [progress.fraction for progress in told]
    assert fractions == sorted(fractions)
    assert before[0].fraction < 0.2 < 0.5 < before[-1].fraction
    assert fractions[-1] == 1.0

    def cancel(progress):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        make_front(FILE, settings, 1, cache, cancel)


def test_limits_hold_for_all_of_the_front(cache):
    limits = dataclasses.replace(GIVEN.limits, cable_speed=0.04)
    front = make_front(FILE, dataclasses.replace(GIVEN, limits=limits), 1, cache, ignore)
    fastest = max(np.pi * gait.stroke * gait.frequency for gait in front.predictions)
    assert 0.03 < fastest <= 0.04


def test_a_box_without_a_moving_gait_is_refused(cache):
    settings = dataclasses.replace(QUICK, bounds=Bounds(0.01, 0.03))
    with pytest.raises(OptimizerError, match="allow longer strokes"):
        make_front(FILE, settings, 1, cache, ignore)


def test_thinning_keeps_the_ends_and_the_cheapest():
    front = build_map(MarginTask(), COARSE_MAP).front
    rows = thinned(front, PAPER, 6)
    kept = front.take(rows)
    assert len(kept) <= 6
    assert kept.power[0] == front.power.min()
    assert kept.speed[-1] == front.speed.max()
    cost = front.power / front.speed
    assert cost.argmin() in rows
    assert thinned(front, PAPER, 1000).tolist() == list(range(len(front)))


def test_the_table_shows_fragile_nominal_and_sound_robust_gaits(cache):
    settings = dataclasses.replace(QUICK, margin=3.4e-3, samples=100)
    robust = three_gaits(make_front(FILE, settings, 1, cache, ignore).predictions)
    nominal = nominal_gaits(FILE, settings, 1)
    assert list(nominal) == list(robust) == ["min_power", "cruise", "max_speed"]
    for name, gait in nominal.items():
        assert gait.success_probability < 0.7 < 0.99 < robust[name].success_probability
        assert gait.stroke_to_lower_edge < 1e-4 < 3e-3 < robust[name].stroke_to_lower_edge
    lines = gait_table(robust, nominal).splitlines()
    assert len(lines) == 8
    assert len({len(line) for line in lines}) == 1
