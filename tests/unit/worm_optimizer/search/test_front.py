# SPDX-License-Identifier: Apache-2.0
"""From parameters to a robust front with its predictions."""

import dataclasses

import pytest
from gaits_for_tests import QUICK, coarse_front, small_front

from worm_model.errors import InputError
from worm_model.gait import Gait, GaitError
from worm_model.parameters import PAPER, ParameterFile
from worm_model.simulation.simulator import evaluate_gait
from worm_optimizer.evaluation.actuator_limits import ActuatorLimits
from worm_optimizer.evaluation.task import Bounds, MarginTask
from worm_optimizer.search.front import (
    given_gait,
    make_front,
    pushing_warning,
    thin_margin_warning,
    thinned,
)
from worm_optimizer.search.search_settings import Robustness

FILE = ParameterFile()


def test_the_margin_is_the_last_of_the_scan_before_the_cliff():
    front = make_front(FILE, QUICK, 1)
    assert front.margin == 3e-3  # the scan's step is 1 mm here
    assert "3.419 mm" in front.reason
    assert "branch with 2 grooves" in front.reason


def test_a_given_gait_has_the_prediction_of_the_front_that_it_was_taken_from():
    front = small_front(2e-3)
    prediction, warning = given_gait(front.three["cruise"].gait, FILE, front.settings)
    assert prediction == front.three["cruise"]
    assert f"{prediction.success_probability:.2f}" in warning
    with pytest.raises(GaitError):
        given_gait(Gait(0.5, 0.2), FILE, QUICK)


def test_a_prediction_is_the_simulators():
    front = small_front(2e-3)
    assert len(front.gaits) >= 17
    for predicted in (*front.gaits, *front.three.values()):
        robust = evaluate_gait(predicted.gait, PAPER)
        nominal = evaluate_gait(Gait(predicted.stroke, predicted.frequency), PAPER)
        assert predicted.margin == 2e-3
        assert predicted.speed == pytest.approx(robust.speed, rel=1e-12)
        assert predicted.power == pytest.approx(robust.power, rel=1e-12)
        assert predicted.cost_of_transport == pytest.approx(robust.cost_of_transport, rel=1e-12)
        assert predicted.nominal_speed == pytest.approx(nominal.speed, rel=1e-12)
        assert predicted.nominal_power == pytest.approx(nominal.power, rel=1e-12)
        assert predicted.groove_phase == pytest.approx(0.0011)


def test_past_the_cliff_the_robust_prediction_is_half_of_the_nominal_one():
    """model_notes.md, 14: both are predicted, so that the difference is visible."""
    fastest = small_front(5e-3).three["max_speed"]
    assert fastest.nominal_grooves_per_cycle == pytest.approx(2.0, abs=1e-3)
    assert fastest.grooves_per_cycle == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize("direction", [1, -1])
def test_the_front_is_that_of_its_direction(direction):
    file = ParameterFile(PAPER.replace(front_mass=0.6))
    front = make_front(file, dataclasses.replace(QUICK, margin=2e-3), direction)
    assert front.direction == direction
    assert {gait.direction for gait in front.gaits} == {direction}
    assert front.three["cruise"].power == pytest.approx(
        evaluate_gait(front.three["cruise"].gait, file.parameters).power
    )


def test_any_phase_gaits_carry_the_margin_that_they_tolerate():
    front = make_front(FILE, dataclasses.replace(QUICK, robustness=Robustness.ANY_PHASE), 1)
    assert front.margin == min(gait.margin for gait in front.gaits) > 1e-3
    assert "at every groove phase" in front.reason
    for gait in front.three.values():
        assert gait.success_probability_any_phase >= 0.8  # the other parameters are still uncertain
        assert gait.nominal_grooves_per_cycle >= gait.grooves_per_cycle - 1e-3


@pytest.mark.parametrize(
    ("robustness", "margin", "success", "facts"),
    [
        (Robustness.MARGIN, 0.9e-3, 1.0, ["0.90 mm", "any_phase", "tune"]),
        (Robustness.MARGIN, 3e-3, 0.89, ["0.89", "any_phase", "tune"]),
        (Robustness.ANY_PHASE, 3e-3, 0.89, ["0.89", "tune"]),
        (Robustness.MARGIN, 3e-3, 0.95, []),
    ],
)
def test_a_thin_margin_or_a_low_success_probability_is_a_warning(
    robustness, margin, success, facts
):
    warning = thin_margin_warning(robustness, margin, success)
    assert bool(warning) == bool(facts)
    assert all(fact in warning for fact in facts)
    assert ("any_phase" in warning) == ("any_phase" in facts)


def test_a_gait_that_needs_a_pushing_cable_is_a_warning():
    slow, fast = Gait(0.0755, 0.15), Gait(0.0755, 0.3)
    assert pushing_warning([slow], PAPER) == ""
    assert "0.300 Hz" in pushing_warning([slow, fast], PAPER)
    assert "31 N" in pushing_warning([fast], PAPER)


@pytest.mark.parametrize("margin", [None, 2e-3])
@pytest.mark.parametrize(
    ("limits", "slowest", "name"),
    [
        (ActuatorLimits(cable_speed=0.005), 0.08, "cable_speed"),
        (ActuatorLimits(cable_force=10.0, electrical_power=100.0), 0.08, "cable_force"),
        (ActuatorLimits(cable_force=500.0, electrical_power=1.0), 0.08, "electrical_power"),
        (
            ActuatorLimits(stall_force=10.0, no_load_speed=0.1),
            0.08,
            "stall_force and no_load_speed",
        ),
        (ActuatorLimits(pushing_force=0.1), 0.2, "pushing_force"),
    ],
)
def test_the_limit_that_excludes_all_gaits_is_named(margin, limits, slowest, name):
    bounds = Bounds(frequency_low=slowest)
    settings = dataclasses.replace(QUICK, margin=margin, limits=limits, bounds=bounds)
    with pytest.raises(InputError, match=f"limits: {name} excludes"):
        make_front(FILE, settings, 1)


@pytest.mark.parametrize("kind", list(Robustness))
def test_a_box_without_a_moving_gait_is_rejected(kind):
    settings = dataclasses.replace(QUICK, bounds=Bounds(0.01, 0.03), robustness=kind)
    with pytest.raises(InputError, match="allow longer strokes"):
        make_front(FILE, settings, 1)


def test_thinning_keeps_the_ends_and_the_cheapest():
    front = coarse_front(MarginTask()).front
    rows = thinned(front, PAPER, 6)
    kept = front.take(rows)
    assert len(kept) <= 6
    assert kept.power[0] == front.power.min()
    assert kept.speed[-1] == front.speed.max()
    assert (front.power / front.speed).argmin() in rows
    assert thinned(front, PAPER, 1000).tolist() == list(range(len(front)))
