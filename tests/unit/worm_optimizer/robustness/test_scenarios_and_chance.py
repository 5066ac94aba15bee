# SPDX-License-Identifier: Apache-2.0
"""Uncertainty, success probability, distances to the edges, and fronts that promise their grooves."""

import numpy as np
import pytest
from gaits_for_tests import coarse_front

from worm_model.parameters import PAPER, ParameterFile
from worm_model.simulation.closed_form import groove_phase
from worm_model.travel_error import PRIOR
from worm_msgs.robot_parameters import TravelError
from worm_optimizer.evaluation.task import MarginTask, Points
from worm_optimizer.robustness import uncertainty
from worm_optimizer.robustness.chance import PromiseTask, tolerated_margins
from worm_optimizer.robustness.prediction import stroke_to_ends, success_probability

EXACT = TravelError(0.0, 0.0)  # a robot that is the model
FILE = ParameterFile(travel_error=EXACT)
PITCH = PAPER.pitch
NOMINAL = MarginTask()
FEW = 5  # frequencies of a front whose gaits are evaluated in many scenarios


def phases_of(scenarios: uncertainty.Scenarios) -> np.ndarray:
    pitch = scenarios.overrides.get("pitch", np.full(len(scenarios), PITCH))
    return np.array(
        [
            groove_phase(PAPER.replace(pitch=d, initial_length=length))
            for d, length in zip(pitch, scenarios.overrides["initial_length"], strict=True)
        ]
    )


def success_of(
    front: Points, scenarios: uncertainty.Scenarios, task: MarginTask = NOMINAL
) -> np.ndarray:
    """Return the success probability of each gait of a front."""
    return success_probability(task, front.stroke, front.frequency, front.count // 3, scenarios)


def test_draws_have_the_stated_widths():
    draws = uncertainty.phase_known(FILE, 4000, seed=1).overrides
    for key, width in uncertainty.MOTION_HALF_WIDTHS.items():
        value = PAPER.as_dict()[key]
        inside = np.mean(np.abs(draws[key] - value) <= width * value)
        low, high = (0.93, 0.97) if width else (1.0, 1.0)
        assert low <= inside <= high, key


def test_the_travel_error_lowers_the_switching_threshold():
    plain = uncertainty.phase_known(FILE, 4000, seed=1).overrides
    weak = ParameterFile(travel_error=TravelError(-0.002, 0.0))
    changed = uncertainty.phase_known(weak, 4000, seed=1).overrides
    assert changed["switching_threshold"] == pytest.approx(plain["switching_threshold"] + 0.002)
    assert all(
        np.array_equal(changed[key], plain[key]) for key in {*plain} - {"switching_threshold"}
    )
    drawn = uncertainty.phase_known(ParameterFile(), 4000, seed=1).overrides
    added = drawn["switching_threshold"] - plain["switching_threshold"]
    assert np.std(added) == pytest.approx(PRIOR.sd, rel=0.05)
    assert abs(np.mean(added)) < 0.05 * PRIOR.sd


def test_a_measured_travel_error_decides_the_success_probability():
    gait = [0.0755], [0.15], [2]

    def success(value: float, sd: float) -> float:
        file = ParameterFile(travel_error=TravelError(value, sd))
        return float(
            success_probability(MarginTask(), *gait, uncertainty.phase_known(file, 400, 1))[0]
        )

    assert success(-0.006, 0.0005) < 0.05
    assert success(0.001, 0.0005) > 0.95
    assert success(0.0, 0.002) < success(0.0, 0.0005)


def test_probabilities_state_whether_a_run_has_measured_the_travel_error():
    assert "if the model is right" in uncertainty.description(ParameterFile())
    measured = uncertainty.description(ParameterFile(travel_error=TravelError(-0.001, 5e-4)))
    assert "if the model is right" not in measured
    assert "-1.0 ± 1.0 mm" in measured


def test_a_files_intervals_replace_the_defaults_on_each_side():
    file = ParameterFile(
        travel_error=EXACT, intervals={"slack": (0.0079, 0.0090), "pitch": (0.0173, 0.0173)}
    )
    below, above = uncertainty.reach_of(file, "slack")
    assert (below, above) == pytest.approx((1e-4, 1e-3))
    draws = uncertainty.phase_known(file, 4000, seed=1).overrides
    assert np.all(draws["pitch"] == 0.0173)
    assert np.quantile(draws["slack"], [0.025, 0.975]) == pytest.approx([0.0079, 0.0090], abs=6e-5)


def test_the_known_phase_is_held_whatever_the_pitch():
    scenarios = uncertainty.phase_known(FILE, 200, seed=1)
    assert np.ptp(scenarios.overrides["pitch"]) > 1e-4
    assert phases_of(scenarios) == pytest.approx(np.full(200, groove_phase(PAPER)), abs=1e-12)


@pytest.mark.parametrize(("half", "scatter", "reach"), [(2e-4, 0.0, 2e-4), (3e-4, 4e-4, 5e-4)])
def test_an_interval_of_the_initial_length_is_one_of_the_phase(half, scatter, reach):
    """The interval is that of the mean. The deviation of one run is added: 0.3 mm and 0.4 mm are 0.5 mm."""
    file = ParameterFile(
        intervals={"initial_length": (PAPER.initial_length - half, PAPER.initial_length + half)},
        run_to_run={"initial_length": scatter / 1.959963984540054},
    )
    spread = phases_of(uncertainty.phase_known(file, 2000, seed=1)) - groove_phase(PAPER)
    assert np.quantile(spread, [0.025, 0.975]) == pytest.approx([-reach, reach], abs=4e-5)


def test_draws_correlate_as_in_the_file_and_keep_their_widths():
    file = ParameterFile(
        intervals={"slack": (0.0076, 0.0084)},
        correlations={("slack", "gain"): -0.9, ("bellows_damping", "power_factor"): -0.99},
    )
    draws = uncertainty.phase_known(file, 4000, seed=1).overrides
    plain = uncertainty.phase_known(FILE, 4000, seed=1).overrides
    assert np.corrcoef(draws["slack"], draws["gain"])[0, 1] == pytest.approx(-0.9, abs=0.02)
    assert abs(np.corrcoef(plain["slack"], plain["gain"])[0, 1]) < 0.05
    assert np.quantile(draws["slack"], [0.025, 0.975]) == pytest.approx([0.0076, 0.0084], abs=5e-5)
    assert draws["clearance"] == pytest.approx(plain["clearance"], rel=1e-12)


def test_correlations_that_exclude_each_other_are_drawn_as_near_as_can_be():
    random = np.random.default_rng(1)
    independent = {key: random.standard_normal(20_000) for key in "abc"}
    impossible = {("a", "b"): 0.9, ("b", "c"): 0.9, ("a", "c"): -0.9}
    drawn = np.corrcoef(list(uncertainty.correlated(independent, impossible).values()))
    assert np.all(np.isfinite(drawn))
    assert drawn[0, 1] == pytest.approx(drawn[1, 2], abs=0.02)
    assert 0.3 < drawn[0, 1] < 0.9
    assert -0.9 < drawn[0, 2] < 0.0


def test_wide_intervals_stay_admissible():
    wide = {key: (0.01 * value, 3.0 * value) for key, value in PAPER.as_dict().items() if value}
    scenarios = uncertainty.phase_known(
        ParameterFile(travel_error=EXACT, intervals=wide), 300, seed=1
    )
    probability = success_probability(MarginTask(), [0.08], [0.2], [1], scenarios)
    assert 0.0 < probability[0] < 1.0


def test_nominal_gaits_are_fragile_and_robust_ones_are_not():
    robust = MarginTask(margin=3.4e-3)
    scenarios = uncertainty.phase_known(FILE, 200, seed=1)
    assert success_of(coarse_front(NOMINAL).front, scenarios).max() < 0.7
    assert success_of(coarse_front(robust).front, scenarios, robust).min() > 0.99


def test_the_branch_ends_at_the_computed_distances():
    task = MarginTask(margin=3.4e-3)
    stroke, frequency = np.array([0.0754, 0.0550, 0.06]), np.array([0.147, 0.08, 0.3])
    lower, upper = stroke_to_ends(task, stroke, frequency)
    nominal = task.with_margin(0.0)
    branch = nominal.grooves(stroke, frequency)
    hair = 2e-8
    assert np.all(nominal.grooves(stroke - lower + hair, frequency) == branch)
    assert np.all(nominal.grooves(stroke - lower - hair, frequency) != branch)
    inside = stroke + upper < task.bounds.stroke_high
    assert np.all(nominal.grooves(stroke + upper - hair, frequency) == branch)
    assert np.all(nominal.grooves(stroke + upper + hair, frequency)[inside] != branch[inside])


def test_any_phase_gaits_keep_their_promise_at_phases_that_they_were_not_made_with():
    guarded = MarginTask(margin=uncertainty.phase_guard(PAPER))
    front = coarse_front(PromiseTask(guarded, uncertainty.every_phase(PAPER), 1.0), FEW).front
    assert set((front.count // 3).tolist()) == {1, 2}
    phase = np.linspace(-0.5, 0.5, 500) * PITCH
    other = uncertainty.Scenarios({"initial_length": PAPER.initial_length + phase})
    assert success_of(front, other).min() == 1.0


def test_a_chance_constrained_front_keeps_its_probability_on_other_draws():
    promise = PromiseTask(MarginTask(), uncertainty.phase_known(FILE, 200, seed=7), 0.9)
    front = coarse_front(promise, FEW).front
    kept = success_of(front, uncertainty.phase_known(FILE, 300, seed=8))
    assert kept.min() > 0.82  # 200 draws give 0.9 to within 0.02, one standard deviation
    assert np.median(kept) > 0.86


def test_the_edge_of_a_promise_is_the_shortest_stroke_that_keeps_it():
    """Compared with a dense scan of all scenarios and strokes."""
    promise = PromiseTask(MarginTask(), uncertainty.phase_known(FILE, 40, seed=3), 0.9)
    frequency = np.array([0.12, 0.25])
    edges = promise.edges(frequency, np.tile([0.01, 0.09], (2, 1)))
    strokes = np.linspace(0.045, 0.09, 901)
    for column, each in enumerate(frequency):
        points = promise.points(strokes, np.full(strokes.size, each))
        for count in (3, 6):
            dense = strokes[points.count >= count].min()
            found = edges.points.stroke[(edges.column == column) & (edges.points.count == count)]
            assert dense - 5e-5 <= found[0] <= dense + 1e-7


def test_a_gait_tolerates_the_computed_margin_and_no_more():
    task = MarginTask()
    front = task.points([0.0754, 0.0754, 0.0550], [0.147, 0.2, 0.08])
    margins = tolerated_margins(task, front)
    assert np.all(margins > 3e-3)
    assert np.all(task.grooves(front.stroke, front.frequency, margins) >= front.count // 3)
    assert np.all(task.grooves(front.stroke, front.frequency, margins + 1e-6) < front.count // 3)


def test_a_promise_that_the_nominal_robot_breaks_stands_no_margin():
    task = MarginTask()
    front = task.points([0.06], [0.2])
    too_much = type(front)(*vars(front).values())
    too_much.count[:] = 15
    assert tolerated_margins(task, too_much).tolist() == [0.0]
