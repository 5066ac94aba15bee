# SPDX-License-Identifier: Apache-2.0
"""The whole identification on virtual robots with known parameters, a small version of the benchmark."""

import re
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from virtual_campaign import SHORT, bench_tests, recording_of, virtual_campaign

from worm_model import parameters
from worm_model.analysis.simulated_run import simulated_run
from worm_model.identification.fit_verdict import Verdict, judge_fit
from worm_model.identification.fits import locomotion
from worm_model.identification.fits.estimate import Estimate
from worm_model.identification.inputs import Inputs
from worm_model.identification.reference_values import MEASURED, ReferenceValues, reference_by_file
from worm_model.identification.report.advice import FREQUENCIES, STAGES, STROKES, advise
from worm_model.identification.report.identification_report import (
    correlations,
    parameter_file,
    summary,
    text_of,
)
from worm_model.identification.stages import FIN, identify

IDENTIFIED = [key for key in parameters.KEYS if key not in MEASURED or key == "pitch"]
DRY = ("rear_dry_friction", "front_dry_friction")  # keys with intervals in N, not relative
BENCH = ("bellows_stiffness", *FIN)
ENERGY = ("bellows_damping", "power_factor")


def covers(result, key, truth):
    estimate = result.estimates[key]
    return estimate.low <= getattr(truth, key) <= estimate.high


@pytest.fixture(scope="module")
def campaigns():
    return [virtual_campaign(seed, SHORT) for seed in (101, 102)]


@pytest.fixture(scope="module")
def results(campaigns):
    return [identify(c.inputs, c.reference) for c in campaigns]


def test_the_intervals_cover_the_truth_and_are_informative(campaigns, results):
    missed = {
        key: [not covers(r, key, c.truth) for c, r in zip(campaigns, results, strict=True)]
        for key in IDENTIFIED
    }
    assert not any(map(all, missed.values())), missed
    assert sum(map(sum, missed.values())) <= 2, missed
    for result, key in product(results, IDENTIFIED):
        estimate = result.estimates[key]
        assert estimate.identifiable
        assert estimate.spread < 0.15 * (1.0 if key in DRY else estimate.value), key


def test_the_model_fits_robots_of_the_model_and_predicts_held_out_runs(results):
    for result in results:
        assert result.fit.verdict is Verdict.FITS
        assert result.fit.causes == ()
        assert result.fit.x1_held_out_m < result.fit.x1_paper_m
        assert set(result.held_out) == {run.name for run in result.runs}
        for name, error in result.held_out.items():
            assert error.x1_rmse < 1e-3
            assert error.length_rmse < min(6e-4, result.paper[name].length_rmse)
            assert abs(error.energy_error) < 0.03


def test_the_verdict_follows_from_the_facts(results):
    result = results[0]

    def judged(held_out=result.held_out, offset=result.energy.fit.clock_offset, **changes):
        motion = replace(result.locomotion, **changes)
        return judge_fit(result.runs, motion, result.actuation, offset, held_out, result.paper)

    def errors(**changes):
        return {name: replace(error, **changes) for name, error in result.held_out.items()}

    assert judged().verdict is Verdict.FITS
    assert judged(inflation=17.0).verdict is Verdict.ROUGHLY
    assert judged(errors(energy_error=-0.1)).verdict is Verdict.ROUGHLY
    assert judged(errors(x1_rmse=8e-4)).verdict is Verdict.DOES_NOT_FIT
    troubled = judged(trouble="no fit settles")
    assert troubled.verdict is Verdict.DOES_NOT_FIT
    assert troubled.causes[0] == "no fit settles"
    (cause,) = judged(offset=np.full(4, 0.09)).causes
    assert "90 ms" in cause


def without_power_after(recording, time):
    kept = recording.power_time <= time
    return replace(recording, power_time=recording.power_time[kept], power=recording.power[kept])


def lacking(inputs, what):
    """Return the inputs without a part of them."""
    bellows = replace(inputs.bellows, y=-inputs.bellows.y)
    blind = tuple(without_power_after(recording, -np.inf) for recording in inputs.recordings)
    changes = {
        "a bellows test with one sign": {"bellows": bellows},
        "bench tests": {"bellows": None, "fin": None},
        "power": {"recordings": blind},
        "an explanation of x1": {},
    }
    return replace(inputs, **changes[what])


@pytest.mark.parametrize(
    ("what", "keys", "text"),
    [
        ("a bellows test with one sign", (BENCH[0], *ENERGY), "the test is not used"),
        pytest.param(
            "bench tests",
            (*BENCH, *ENERGY, *DRY, "viscous_friction", "switching_threshold"),
            "add a fin test",
            marks=pytest.mark.night,
        ),
        pytest.param(
            "power", ("idle_power", *ENERGY), "no run has power samples", marks=pytest.mark.night
        ),
        (
            "an explanation of x1",
            (*ENERGY, *DRY, "viscous_friction", "switching_threshold", "pitch"),
            "does not fit",
        ),
    ],
)
def test_what_depends_on_missing_data_is_not_claimed_and_all_else_is(
    campaigns, monkeypatch, what, keys, text
):
    campaign = campaigns[0]
    if what == "an explanation of x1":
        monkeypatch.setattr(locomotion, "is_lost", lambda _: True)
    inputs = lacking(campaign.inputs, what)
    result = identify(inputs, campaign.reference)
    unknown = {key for key, estimate in result.estimates.items() if not estimate.identifiable}
    assert unknown == set(keys)
    assert set(parameter_file(result, inputs).intervals).isdisjoint(unknown)
    page = text_of(result, advise(result), [])
    assert text in page
    assert "not identified" in page
    given = campaign.reference.parameters
    assert result.estimates["bellows_damping"].value == given.bellows_damping


@pytest.mark.night
def test_a_run_whose_power_ends_early_is_left_out_of_the_energy_alone(campaigns):
    campaign = campaigns[0]
    spoilt, *others = campaign.inputs.recordings
    recordings = (without_power_after(spoilt, 0.0), *others)
    result = identify(replace(campaign.inputs, recordings=recordings), campaign.reference)
    (warning,) = [text for text in result.warnings if "c_b and α_P" in text]
    assert warning.startswith(f"{spoilt.name}: ")
    assert [run.recording.name for run in result.energy.runs] == [r.name for r in others]
    assert len(result.runs) == len(recordings)
    assert np.isnan(result.held_out[spoilt.name].energy_error)
    assert np.isfinite(result.held_out[spoilt.name].x1_rmse)
    assert covers(result, "bellows_damping", campaign.truth)
    assert "unknown" in text_of(result, advise(result), [])


def advice_for(result, key, estimate):
    return advise(replace(result, estimates={**result.estimates, key: estimate}))


@pytest.mark.parametrize("key", [key for keys in STAGES.values() for key in keys])
def test_each_parameter_of_the_stages_gets_a_gait_that_narrows_its_interval(results, key):
    value = results[0].estimates[key].value
    advice = advice_for(results[0], key, Estimate(value, 0.6 * value, 1.4 * value))
    assert f"that of {key} " in advice
    stroke, frequency, width = re.search(r"at (\S+) m and (\S+) Hz .* to (\d+) %", advice).groups()
    assert (float(stroke), float(frequency)) in list(product(STROKES, FREQUENCIES))
    assert 0 <= int(width) < 100


def test_a_slack_of_nothing_and_no_gait_that_goes_far_stop_no_advice(results, monkeypatch):
    result = results[0]
    assert "that of slack" not in advice_for(result, "slack", Estimate(0.0, -1e-5, 1e-5))
    vague = replace(result.estimates["slack"], identifiable=False, note="why")
    assert advice_for(result, "slack", vague) == "slack: why"
    monkeypatch.setattr("worm_model.identification.report.advice.recorded", lambda *_: None)
    assert "5 ridges" in advice_for(result, "viscous_friction", Estimate(95.0, 60.0, 130.0))


def test_the_outputs_agree_with_each_other(campaigns, results):
    result = results[0]
    file, found = parameter_file(result, campaigns[0].inputs), summary(result)
    assert file.parameters == result.parameters
    assert set(found["parameters"]) == set(parameters.KEYS)
    for entry in found["parameters"].values():
        assert {"value", "low", "high", "identifiable"} <= set(entry)
    assert set(found["fit"]) >= {"verdict", "causes", "inflation", "groove_scatter_m"}
    errors = {"x1_rmse", "length_rmse", "power_rmse", "energy_error"}
    assert all(set(run) >= errors for run in found["runs"].values())
    slack = found["parameters"]["slack"]
    assert file.intervals["slack"] == (slack["low"], slack["high"])
    text = text_of(result, advise(result), [])
    assert all(run.name in text for run in result.runs)
    named = {frozenset(pair[:2]) for each in results for pair in correlations(each)}
    assert frozenset(ENERGY) in named


def test_robots_of_the_model_have_hardly_a_travel_error(campaigns, results):
    files = [parameter_file(r, c.inputs) for c, r in zip(campaigns, results, strict=True)]
    measured = [any(np.isfinite(m) for m, _ in result.margins.values()) for result in results]
    assert any(measured)  # a hidden marker can leave too few switches
    for file, result, seen in zip(files, results, measured, strict=True):
        assert file.travel_error == result.travel_error
        assert (file.travel_error is not None) == seen
        if seen:
            # of the worst cycle of each run, which lies below the mean by the scatter of the grooves
            assert -0.002 < file.travel_error.value < 0.001
            assert summary(result)["travel_error"]["value"] == file.travel_error.value


def test_the_initial_length_is_a_mean_with_the_scatter_of_the_runs(campaigns, results):
    for result in results:
        lengths = np.array([run.length.initial_length for run in result.runs])
        estimate, deviation = result.estimates["initial_length"], lengths.std(ddof=1)
        assert estimate.value == pytest.approx(lengths.mean())
        assert estimate.spread == pytest.approx(3.182 * deviation / 2.0, rel=1e-3)
        assert f"{deviation * 1e3:.3f} mm" in estimate.note
        file = parameter_file(result, campaigns[0].inputs)
        assert file.run_to_run == {"initial_length": pytest.approx(deviation)}


@pytest.mark.night
def test_a_cable_that_cannot_push_is_identified_as_such_and_reported(tmp_path):
    truth = parameters.PAPER.replace(one_sided_cable=True, bellows_damping=950.0, power_factor=2.9)
    recordings = tuple(
        recording_of(simulated_run(gait, truth, 5, 60.0).as_recorded(), f"run_{k}")
        for k, (gait, _) in enumerate(SHORT[:3])
    )
    inputs = Inputs(recordings, *bench_tests(truth, np.random.default_rng(0)), None)
    given = ReferenceValues(parameters.PAPER, {}, "the paper").with_one_sided_cable()
    result = identify(inputs, given)
    for key in parameters.FITTED_WITH_FORM:
        assert result.estimates[key].value == pytest.approx(getattr(truth, key), rel=0.02)
        assert "cannot push" in result.estimates[key].note
    assert max(abs(error.energy_error) for error in result.held_out.values()) < 5e-3
    assert summary(result)["one_sided_cable"] is True
    path = tmp_path / "robot.yaml"
    parameters.write_parameter_file(path, parameter_file(result, inputs))
    assert parameters.load_parameters(path) == result.parameters
    without = replace(inputs, recordings=recordings[::2], bellows=None)
    result = identify(without, given)
    assert any("not applied" in warning for warning in result.warnings)
    assert not result.parameters.one_sided_cable
    again = identify(without, reference_by_file(parameters.ParameterFile(truth), "it"))
    assert again.parameters.one_sided_cable
    assert again.parameters.bellows_damping == 950.0


@pytest.mark.night
def test_a_fin_that_is_given_as_exact_is_used_as_exact(campaigns):
    campaign = campaigns[0]
    fins = {key: getattr(campaign.truth, key) for key in FIN}
    given = replace(
        campaign.reference,
        parameters=campaign.reference.parameters.replace(**fins),
        intervals={key: (value, value) for key, value in fins.items()},
    )
    result = identify(replace(campaign.inputs, fin=None), given)
    assert result.locomotion.variants == ()
    assert result.estimates["viscous_friction"].identifiable
    assert covers(result, "viscous_friction", campaign.truth)
