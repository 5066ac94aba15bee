# SPDX-License-Identifier: Apache-2.0
"""Measured margins of a robot that the model does not contain, compared with the true ones.

The true margin of a fin is the increase of its switching threshold after which the robot loses a groove.
"""

import math
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from foreign_robot import EPOCH, Camera, ForeignRobot, crawl, some_robot
from recorded_run import Instruments, exact_run

from worm_model.analysis.run_metrics import measure_margin
from worm_model.errors import RecordingError
from worm_model.gait import REVERSE, Gait
from worm_model.margin.cycle_margin import negative_margin
from worm_model.margin.half_cycles import Fin, half_cycles, motion_of
from worm_model.margin.measured_margin import RunMargin
from worm_model.margin.predicted_margin import predicted_margin
from worm_model.parameters import PAPER
from worm_model.run import Run, TrackerSamples
from worm_model.simulation.closed_form import deflected_share
from worm_model.simulation.simulator import simulate

CYCLES = 5
GAIT, CAMERA = Gait(0.075, 0.2), Camera()
EXCESS = {Fin.REAR: "rear_excess", Fin.FRONT: "front_excess"}
OTHER = {Fin.REAR: Fin.FRONT, Fin.FRONT: Fin.REAR}


@lru_cache(maxsize=256)
def recorded(robot: ForeignRobot, gait: Gait = GAIT, camera: Camera = CAMERA) -> Run:
    return crawl(robot, gait, CYCLES, camera, seed=robot.pipe).run


@lru_cache(maxsize=256)
def measured(robot: ForeignRobot, gait: Gait = GAIT, camera: Camera = CAMERA) -> RunMargin:
    return measure_margin(recorded(robot, gait, camera), PAPER)


def least_true_margin(robot: ForeignRobot, gait: Gait, fin: Fin) -> float:
    """Return the largest excess threshold (m) with which no cycle but the first loses a groove."""

    def grooves(excess: float) -> int:
        changed = replace(robot, **{EXCESS[fin]: excess})
        return int(crawl(changed, gait, CYCLES).grooves(CYCLES, gait.frequency)[1:].min())

    kept, lost, promised = 0.0, 0.012, grooves(0.0)
    if grooves(lost) >= promised:
        return math.nan
    for _ in range(7):
        middle = 0.5 * (kept + lost)
        kept, lost = (middle, lost) if grooves(middle) >= promised else (kept, middle)
    return 0.5 * (kept + lost)


def length_errors(
    robot: ForeignRobot, gait: Gait, camera: Camera
) -> dict[Fin, list[tuple[float, float]]]:
    """Return measured minus true travel (m) between last switch and turning point, and its standard deviation (m).

    There is one pair for each half cycle of a fin.
    """
    truth = crawl(robot, gait, CYCLES, camera, seed=robot.pipe)
    found = measure_margin(truth.run, PAPER)
    motion = motion_of(truth.run, gait, EPOCH, CYCLES)
    assert motion is not None
    errors: dict[Fin, list[tuple[float, float]]] = {fin: [] for fin in Fin}
    for half in half_cycles(motion, gait, CYCLES)[1:-1]:
        groove = truth.rear_groove if half.fin is Fin.REAR else truth.front_groove
        start, end = np.searchsorted(truth.time, np.array([half.start, half.end]) - camera.delay_s)
        stepped = start - 100 + np.flatnonzero(np.diff(groove[start - 100 : end + 200]))
        travel = half.travel(truth.front - truth.rear)
        near = travel[end - 200 : end + 200]
        true = (near.max() if near.max() > near.min() else near[0]) - travel[stepped[-1]]
        own = getattr(found.cycles[half.cycle - 1], half.fin.value)
        errors[half.fin].append((own.length - true, own.length_sd))
    return errors


@pytest.mark.parametrize(("frequency", "robots"), [(0.1, 1), (0.2, 2), (0.23, 2)])
def test_the_least_margin_of_a_run_is_the_increase_of_the_threshold_that_loses_a_groove(
    frequency, robots
):
    gait = Gait(0.075, frequency)
    errors = []
    for robot in map(some_robot, range(robots)):
        found = measured(robot, gait)
        for fin in Fin:
            true = least_true_margin(robot, gait, fin)
            errors.append(found.margins(fin)[0].min() - true)
    assert np.nanmax(np.abs(errors)) < 0.0012
    assert abs(np.nanmean(errors)) < 0.0005


@pytest.mark.parametrize(
    "camera",
    [
        Camera(),
        Camera(rate_hz=15.0),
        Camera(rate_hz=15.0, noise_m=0.0005),
        Camera(rate_hz=120.0),
        Camera(delay_s=0.05),
    ],
)
def test_the_travel_after_the_last_switch_is_measured_in_every_cycle(camera):
    gaits = Gait(0.075, 0.1), GAIT, Gait(0.08, 0.24)
    errors = [length_errors(some_robot(k), gait, camera) for k, gait in enumerate(gaits)]
    for fin in Fin:
        error, sd = np.concatenate([each[fin] for each in errors]).T
        known = np.isfinite(error)
        assert known.mean() > 0.85
        assert abs(error[known].mean()) < 0.0006
        assert error[known].std() < 0.001
        assert np.abs(error[known]).max() < 0.004  # no switch is confused with the one before
        assert fin is Fin.FRONT or (np.abs(error[known]) > 2.0 * sd[known]).mean() < 0.1


def test_of_a_run_that_never_gains_its_grooves_both_fins_are_named():
    lacking = measure_margin(recorded(some_robot(1), Gait(0.06, 0.15)), PAPER, 2)
    assert not lacking.shows_losing_fin
    assert "rear or front" in str(lacking)
    assert measured(some_robot(1), Gait(0.078, 0.15)).shows_losing_fin


def test_a_rear_margin_is_at_most_three_standard_deviations_too_high():
    gait, robot, cycles = Gait(0.06, 0.15), some_robot(2), 6
    found = measure_margin(crawl(robot, gait, cycles, seed=2).run, PAPER)
    for cycle in found.cycles[1:]:
        excess = cycle.rear.margin - 3.0 * cycle.rear.margin_sd
        raised = replace(robot, rear_excess=excess)
        gained = crawl(raised, gait, cycles).grooves(cycles, gait.frequency)
        assert gained[cycle.cycle - 1] == found.grooves


@pytest.mark.parametrize("fin", list(Fin))
def test_lost_grooves_are_negative_margins_of_the_fin_that_lost_them(fin):
    gait, other = Gait(0.078, 0.15), OTHER[fin]
    robot = replace(some_robot(0), **{EXCESS[fin]: 0.008})
    found = measure_margin(recorded(robot, gait), PAPER, grooves=2)
    assert {cycle.grooves for cycle in found.cycles[1:]} == {1}
    assert found.margins(fin)[0].max() < -0.001
    assert found.margins(other)[0].min() > 0.0
    assert found.keeps is not None
    assert found.keeps.high < 0.2


def test_a_groove_more_than_wanted_is_to_spare_for_both_fins():
    gait = Gait(0.095, 0.15)
    three, two = (
        measure_margin(recorded(some_robot(0), gait), PAPER, grooves) for grooves in (3, 2)
    )
    for fin in Fin:
        more = two.margins(fin)[0] - three.margins(fin)[0]
        assert more == pytest.approx(deflected_share(PAPER) * PAPER.pitch)
    assert two.keeps is not None
    assert two.keeps.low > 0.99


@pytest.mark.parametrize("measured_m", [-0.005, 0.0, 0.0004, 0.004])
def test_the_margin_of_a_cycle_that_missed_a_groove_is_negative(measured_m):
    margin = negative_margin(measured_m, 0.0004)
    assert margin < 0.0
    assert margin == pytest.approx(min(measured_m, 0.0), abs=0.0004)


def test_three_grooves_and_shaped_gaits_are_measured():
    for gait, grooves in (
        (Gait(0.095, 0.15), 3),
        (Gait(0.075, 0.15, profile="trapezoid", ramp_share=0.25), 2),
        (Gait(0.075, 0.15, contraction_share=0.7), 2),
        (Gait(0.07, 0.15, pretension=0.005), 2),
    ):
        found = measured(some_robot(0), gait)
        assert found.grooves == grooves
        assert [cycle.grooves for cycle in found.cycles[1:]] == [grooves] * (CYCLES - 1)
        for fin in Fin:
            assert found.margins(fin)[0].size >= CYCLES - 2
            assert 0.0 < found.margins(fin)[0].mean() < 0.006


def test_a_run_in_reverse_is_the_mirror_image_of_one_forward():
    run = recorded(some_robot(1))
    tracker, states = run.tracker, run.gait_state
    reverse = replace(
        run,
        tracker=TrackerSamples(tracker.stamp, -tracker.front_position, -tracker.rear_position),
        gait_state=replace(states, direction=0 * states.direction + REVERSE),
    )
    found, forward = measure_margin(reverse, PAPER), measured(some_robot(1))
    assert found.gait.direction == REVERSE
    assert found.cycles == forward.cycles


def seen(run: Run, **positions) -> RunMargin:
    """Return the measured margins of a run with other positions of its tracker."""
    return measure_margin(replace(run, tracker=replace(run.tracker, **positions)), PAPER, 2)


def test_hidden_and_confused_markers_leave_the_other_cycles_as_they_are():
    run, draw = recorded(some_robot(0)), np.random.default_rng(0)
    whole, time = measured(some_robot(0)), (run.tracker.stamp - EPOCH) * 1e-9
    hidden = (time > 11.8) & (time < 13.0)
    found = seen(run, rear_position=np.where(hidden, np.nan, run.tracker.rear_position))
    for cycle in (1, 3):
        expected = whole.cycles[cycle].rear.margin
        assert found.cycles[cycle].rear.margin == pytest.approx(expected, abs=0.0006)
    wrong = draw.random(time.size) < 0.01
    off = np.where(wrong, draw.choice([-0.02, 0.02], time.size), 0.0)
    found = seen(run, front_position=run.tracker.front_position + off)
    for one, other in zip(found.cycles, whole.cycles, strict=True):
        assert one.front.length == pytest.approx(other.front.length, abs=0.0006)
        assert one.rear.length == pytest.approx(other.rear.length, abs=0.0006)


@pytest.mark.parametrize(("first", "last"), [(3.0, 5.5), (3.5, 4.7)])
def test_a_fin_whose_last_switch_may_be_hidden_is_not_measured(first: float, last: float):
    gait = Gait(0.0713, 0.2)
    run = crawl(some_robot(1), gait).run
    phase = np.mod((run.tracker.stamp - run.gait_state.onset.max()) * 1e-9 - first, gait.period)
    front = np.where(phase < last - first, np.nan, run.tracker.front_position)
    assert Fin.FRONT in measure_margin(run, PAPER, 2).beliefs
    assert Fin.FRONT not in seen(run, front_position=front).beliefs


def test_without_a_tracker_nothing_is_measured():
    run = replace(recorded(some_robot(0)), tracker=TrackerSamples())
    found = measure_margin(run, PAPER)
    assert (found.source, found.cycles, found.keeps) == ("", (), None)
    assert found.as_json()["rear_margin_m"] is None
    with pytest.raises(RecordingError):
        measure_margin(Run(), PAPER)


def test_a_stopped_run_is_measured_up_to_its_last_whole_cycle():
    run, whole = recorded(some_robot(0)), measured(some_robot(0))
    kept = run.tracker.stamp < EPOCH + round(3.6 * GAIT.period * 1e9)
    tracker = TrackerSamples(*(values[kept] for values in vars(run.tracker).values()))
    found = measure_margin(replace(run, tracker=tracker), PAPER)
    assert len(found.cycles) == 3
    expected = whole.margins(Fin.REAR)[0][0]
    assert found.margins(Fin.REAR)[0][0] == pytest.approx(expected, abs=0.0005)
    single = measure_margin(crawl(some_robot(0), GAIT, 1).run, PAPER)  # states no probability
    assert (len(single.cycles), single.keeps) == (1, None)
    assert single.cycles[0].front.length > 0.0


@pytest.mark.parametrize("groove_phase", [-0.006, 0.0, 0.0011, 0.004])
def test_on_the_model_itself_the_predicted_margin_is_measured(groove_phase):
    gait = Gait(0.078, 0.2)
    robot = PAPER.replace(initial_length=17 * PAPER.pitch + groove_phase)
    instruments = Instruments(camera_noise=0.00025, rest=1.0)
    run = exact_run(gait, robot, instruments, 0, CYCLES * gait.period + 0.5, CYCLES)
    found = measure_margin(run, robot)
    least = min(found.margins(fin)[0].mean() for fin in Fin)
    predicted = predicted_margin(gait, robot, found.grooves)
    assert least == pytest.approx(predicted, abs=0.0007)


def test_the_predicted_margin_counts_from_the_requested_grooves():
    gait = Gait(0.075, 0.2)
    one, two, three = (predicted_margin(gait, PAPER, n) for n in (1, 2, 3))
    assert one > two > 0.0 > three
    thresholds = (PAPER.switching_threshold + two + change for change in (-1e-5, 1e-5))
    before, beyond = (
        simulate(gait, PAPER.replace(switching_threshold=threshold)).at(25.0).x1
        for threshold in thresholds
    )
    assert before > beyond + PAPER.pitch


def test_a_cycle_with_hidden_markers_does_not_change_which_fin_lacks_the_groove():
    run = recorded(some_robot(1))
    time = (run.tracker.stamp - EPOCH) * 1e-9
    seen = np.abs(time - 7.6) > 0.3  # hidden at the rear fin's switch
    fields = (run.tracker.stamp, run.tracker.rear_position, run.tracker.front_position)
    hidden = replace(run, tracker=TrackerSamples(*(field[seen] for field in fields)))
    whole, part = (measure_margin(each, PAPER, 3) for each in (run, hidden))
    assert len(part.margins(Fin.REAR)[0]) < len(whole.margins(Fin.REAR)[0])
    for fin, lacks in ((Fin.REAR, False), (Fin.FRONT, True)):
        margins = part.margins(fin)[0]
        assert (margins < 0.0).all() == lacks
        assert margins == pytest.approx(whole.margins(fin)[0][-len(margins) :], abs=1e-4)
