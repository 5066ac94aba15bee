# SPDX-License-Identifier: Apache-2.0
"""The whole identification on virtual robots whose parameters are known, a small version of the benchmark."""

from dataclasses import replace

import numpy as np
import pytest
from virtual_campaign import SHORT, virtual_campaign

from worm_model.identification.advice import advise
from worm_model.identification.given import MEASURED
from worm_model.identification.pipeline import identify
from worm_model.identification.report import text_of
from worm_model.identification.results import correlations, parameter_file, summary
from worm_model.parameters import KEYS, PAPER

IDENTIFIED = [key for key in KEYS if key not in MEASURED]


@pytest.fixture(scope="module")
def campaigns():
    return [virtual_campaign(seed, SHORT) for seed in (101, 102)]


@pytest.fixture(scope="module")
def results(campaigns):
    return [identify(c.inputs, c.given, seed) for seed, c in enumerate(campaigns)]


def test_the_intervals_cover_the_truth(campaigns, results):
    covered = {
        (index, key): result.estimates[key].low
        <= getattr(campaign.truth, key)
        <= result.estimates[key].high
        for index, (campaign, result) in enumerate(zip(campaigns, results, strict=True))
        for key in IDENTIFIED
    }
    missed = [place for place, hit in covered.items() if not hit]
    assert len(missed) <= 0.1 * len(covered), missed


def test_the_intervals_tell_something(results):
    widest = {
        key: max(r.estimates[key].spread / r.estimates[key].value for r in results)
        for key in IDENTIFIED
    }
    assert all(r.estimates[key].identifiable for r in results for key in IDENTIFIED)
    assert max(widest.values()) < 0.15, widest


def test_values_lie_in_their_intervals(results):
    for result in results:
        for key, estimate in result.estimates.items():
            assert estimate.low <= estimate.value <= estimate.high, key
            assert getattr(result.parameters, key) == estimate.value


def test_held_out_runs_are_predicted_better_than_by_the_papers_table(results):
    for result in results:
        assert set(result.held_out) == {run.name for run in result.runs}
        for name, error in result.held_out.items():
            assert error.x1_rmse < 1e-3
            assert error.length_rmse < min(6e-4, result.paper[name].length_rmse)
            assert abs(error.energy_error) < 0.03


def test_the_same_inputs_and_seed_give_the_same_numbers(campaigns, results):
    again = identify(campaigns[0].inputs, campaigns[0].given, 0)
    assert again.estimates == results[0].estimates
    assert again.held_out == results[0].held_out


def test_what_moves_together_is_named(results):
    named = {frozenset(pair[:2]) for result in results for pair in correlations(result)}
    assert frozenset({"bellows_damping", "power_factor"}) in named


def test_advice_names_the_widest_interval(results):
    advice = advise(results[0])
    estimate = results[0].estimates[advice.key]
    assert advice.key in advice.text
    others = [e.spread / abs(e.value) for k, e in results[0].estimates.items() if k != advice.key]
    assert estimate.spread / estimate.value >= max(others) - 1e-12
    assert advice.gait is None or 0.0 < advice.shrunk < 1.0


def test_the_outputs_agree_with_each_other(campaigns, results):
    result = results[0]
    file, found = parameter_file(result, campaigns[0].inputs), summary(result)
    assert file.parameters == result.parameters
    assert set(found["parameters"]) == set(KEYS)
    assert file.intervals["slack"] == (
        found["parameters"]["slack"]["low"],
        found["parameters"]["slack"]["high"],
    )
    text = text_of(result, [])
    assert all(run.name in text for run in result.runs)
    assert np.isfinite(found["runs"]["run_1"]["energy_error"])


def test_without_bench_tests_nothing_is_claimed_that_depends_on_them(campaigns):
    campaign = campaigns[0]
    blind = replace(campaign.inputs, bellows=None, fin=None)
    result = identify(blind, campaign.given, 0)
    unknown = {key for key, estimate in result.estimates.items() if not estimate.identifiable}
    bench = {"bellows_stiffness", "clearance", "engaged_stiffness", "disengaged_stiffness"}
    conditional = {
        "viscous_friction",
        "switching_threshold",
        "bellows_damping",
        "power_factor",
    }
    assert unknown == bench | conditional
    assert set(parameter_file(result, blind).intervals).isdisjoint(unknown)
    assert "not identified" in text_of(result, [])
    assert result.estimates["bellows_damping"].value == PAPER.bellows_damping
    assert summary(result)["parameters"]["viscous_friction"]["note"].endswith("add a fin test")
