# SPDX-License-Identifier: Apache-2.0
import math
from dataclasses import replace

import pytest

from worm_driver.gait.gait_metrics import RunRecord, distance, run_metrics
from worm_driver.gait.gait_player import Ending, PlayedRun
from worm_driver.power.ina219 import PowerSample, SampleStatus
from worm_msgs.gait import Gait
from worm_msgs.robot_parameters import RobotParameters

FREQUENCY = 0.5
PERIOD = 2.0
ONSET = 10.0
BODY = RobotParameters()
RUN = PlayedRun(
    1, Gait(0.07, FREQUENCY), 5, 5, rest_start=8.9, onset=ONSET, end=20.0, ending=Ending.COMPLETED
)


def valid(time: float, power: float) -> PowerSample:
    return PowerSample(time, SampleStatus.VALID, 12.0, power / 12.0)


def bad(time: float, status: SampleStatus) -> PowerSample:
    return PowerSample(time, status)


def power_of(time: float) -> float:
    """Return 0.8 W at rest; in the first two cycles 100 W, which must not count; 5 W and 7 W alternating after."""
    if time < ONSET:
        return 0.8
    if time < ONSET + 2 * PERIOD:
        return 100.0
    return 5.0 if (time - ONSET) % PERIOD < PERIOD / 2 else 7.0


def record(speed: float = 0.01) -> RunRecord:
    """Return 100 Hz power and a 30 Hz tracker; the first two cycles are ten times as fast."""
    result = RunRecord()
    result.power = [valid(8.5 + 0.01 * i, power_of(8.5 + 0.01 * i)) for i in range(1200)]
    for i in range(400):
        time = 8.5 + i / 30
        moved = 10 * speed * min(max(time - ONSET, 0.0), 2 * PERIOD)
        moved += speed * max(time - ONSET - 2 * PERIOD, 0.0)
        result.positions.append((time, 0.3 + moved))
    return result


def test_figures_are_those_of_the_last_three_cycles():
    found = run_metrics(RUN, record(), BODY)
    assert (found.cycles_completed, found.cycles_averaged) == (5, 3)
    assert found.speed == pytest.approx(0.01)
    assert found.power == pytest.approx(6.0, rel=2e-3)
    assert found.cost_of_transport == pytest.approx(6.0 / (0.858 * 9.80665 * 0.01), rel=2e-3)
    assert found.idle_power == pytest.approx(0.8)
    assert found.reasons == ()


def test_idle_power_is_the_first_ten_samples_of_the_rest():
    seen = record()
    first = [sample for sample in seen.power if sample.time >= RUN.rest_start][:10]
    for index, sample in enumerate(seen.power):
        if (
            RUN.rest_start <= sample.time < ONSET and sample not in first
        ) or sample.time < RUN.rest_start:
            seen.power[index] = valid(sample.time, 50.0)
    assert run_metrics(RUN, seen, BODY).idle_power == pytest.approx(0.8)


def test_reverse_speed_is_along_the_gaits_direction():
    reverse = replace(RUN, gait=Gait(0.07, FREQUENCY, -1))
    assert run_metrics(reverse, record(-0.01), BODY).speed == pytest.approx(0.01)
    assert run_metrics(RUN, record(-0.01), BODY).speed == pytest.approx(-0.01)


def test_a_marker_hidden_for_a_moment_is_bridged_and_reported():
    """Around the end, x1 curves: a straight line over the gap would be 2 mm off."""
    seen, whole = record(), record()
    whole.positions = [(t, x + 0.05 * (t - 20.0) ** 2) for t, x in seen.positions]
    seen.positions = [(t, x) for t, x in whole.positions if not 19.8 < t < 20.2]
    found = run_metrics(RUN, seen, BODY)
    assert found.speed == pytest.approx(run_metrics(RUN, whole, BODY).speed, abs=2e-5)
    (reason,) = found.reasons
    assert "speed is less certain" in reason
    assert "0.40 s" in reason


@pytest.mark.parametrize(
    ("seen_at", "causes"),
    [
        (lambda _: False, ["no samples arrived on the topic tracker"]),
        (lambda t: not 19.7 < t < 20.3, ["did not see the robot at the start or the end"]),
        (lambda t: t <= 19.45, ["last saw the robot 0.567 s before the end"]),
        (lambda t: t >= 14.5, ["first saw the robot 0.500 s after the start"]),
        (lambda t: 14.5 <= t <= 19.45, ["first saw the robot 0.500 s", "last saw the robot 0.567"]),
        (lambda t: t <= 10.0, ["last saw the robot 10.000 s before the end"]),
        (lambda t: not 19.96 < t < 20.03, []),
    ],
)
def test_a_tracker_that_misses_an_end_of_the_averaged_cycles_is_the_stated_cause(seen_at, causes):
    seen = record()
    seen.positions = [(time, place) for time, place in seen.positions if seen_at(time)]
    found = run_metrics(RUN, seen, BODY)
    assert found.power == pytest.approx(6.0, rel=2e-3)
    if not causes:
        assert found.speed == pytest.approx(0.01)
        return
    assert math.isnan(found.speed)
    assert math.isnan(found.cost_of_transport)
    (reason,) = found.reasons
    assert reason.startswith("no speed: ")
    assert "inf" not in reason
    assert all(cause in reason for cause in causes)


def test_a_robot_that_stands_has_no_cost_of_transport():
    found = run_metrics(RUN, record(0.0), BODY)
    assert found.speed == 0.0
    assert math.isnan(found.cost_of_transport)
    assert "the speed is 0" in found.reasons[0]


def without(first: int, last: int, step: int, status: SampleStatus) -> RunRecord:
    """Return a record some of whose power samples have a status instead of a value."""
    seen = record()
    seen.power[first:last:step] = [bad(s.time, status) for s in seen.power[first:last:step]]
    return seen


@pytest.mark.parametrize(
    ("seen", "reason"),
    [
        (without(900, 901, 1, SampleStatus.OVERFLOW), "1 samples overflowed"),
        (without(300, 301, 1, SampleStatus.OVERFLOW), ""),  # before the averaged cycles
        (without(800, 1000, 3, SampleStatus.NOT_READY), ""),
        (without(800, 830, 1, SampleStatus.BUS_ERROR), "no valid sample for 0.31 s"),
    ],
    ids=["overflow", "earlier overflow", "not ready", "gone for a while"],
)
def test_samples_without_a_value_give_the_mean_of_the_others_or_a_reason(seen, reason):
    found = run_metrics(RUN, seen, BODY)
    assert math.isnan(found.power) == bool(reason)
    assert reason or found.power == pytest.approx(6.0, rel=5e-3)
    assert not reason or reason in found.reasons[0]


def lost_at_the_start(*found: float) -> RunRecord:
    """Return a record whose only valid power samples in the first 0.5 s of the averaged cycles are those given, s."""
    seen, start = record(), ONSET + 2 * PERIOD
    lost = [s.time for s in seen.power if start <= s.time < start + 0.5]
    keep = {min(lost, key=lambda time, at=start + at: abs(time - at)) for at in found}
    seen.power = [
        bad(s.time, SampleStatus.BUS_ERROR) if s.time in lost and s.time not in keep else s
        for s in seen.power
    ]
    return seen


def test_only_a_gap_between_valid_samples_or_to_an_end_of_the_cycles_is_too_long():
    """The second sample comes 0.28 s after the start, but no gap is longer than 0.2 s."""
    found = run_metrics(RUN, lost_at_the_start(0.2, 0.28, 0.4), BODY)
    assert found.power == pytest.approx(6.0, rel=2e-3)
    assert found.reasons == ()
    late = run_metrics(RUN, lost_at_the_start(0.27, 0.35, 0.45), BODY)
    assert math.isnan(late.power)
    assert "no valid sample for 0.27 s" in late.reasons[0]


def test_without_a_power_sensor_there_is_a_reason_for_each_figure():
    seen = record()
    seen.power.clear()
    reasons = run_metrics(RUN, seen, BODY).reasons
    assert any(reason.startswith("no power") for reason in reasons)
    assert any(reason.startswith("no idle power: 0 valid samples") for reason in reasons)


def test_uneven_sampling_does_not_bias_the_mean():
    """Every other sample of the expensive halves is lost: a plain mean would be 5.67 W."""
    seen = record()
    seen.power = [
        sample
        for index, sample in enumerate(seen.power)
        if sample.power < 6.5 or index % 2 or sample.power > 50.0
    ]
    assert run_metrics(RUN, seen, BODY).power == pytest.approx(6.0, rel=5e-3)


def test_a_shunt_with_swapped_inputs_gives_no_power_and_the_remedy():
    seen = record()
    seen.power = [replace(sample, current=-sample.current) for sample in seen.power]
    found = run_metrics(RUN, seen, BODY)
    assert math.isnan(found.power)
    assert math.isnan(found.idle_power)
    assert math.isnan(found.cost_of_transport)
    (reason,) = found.reasons
    assert "-0.07 A" in reason
    assert "IN+ and IN-" in reason


def test_noise_around_no_current_is_no_swapped_shunt():
    seen = record()
    for index, sample in enumerate(seen.power):
        if sample.time < ONSET:
            seen.power[index] = replace(sample, current=-0.015 + 0.01 * (-1) ** index)
    assert run_metrics(RUN, seen, BODY).power == pytest.approx(6.0, rel=2e-3)


@pytest.mark.parametrize(
    ("cycles", "ending", "completed", "averaged"),
    [(2.0, Ending.CANCELLED, 2, 2), (3.5, Ending.STOPPED, 3, 3), (0.5, Ending.STOPPED, 0, 0)],
)
def test_a_run_that_ends_early_averages_the_cycles_it_completed(
    cycles, ending, completed, averaged
):
    ended = replace(RUN, end=ONSET + cycles * PERIOD, ending=ending)
    found = run_metrics(ended, record(), BODY)
    assert (found.cycles_completed, found.cycles_averaged) == (completed, averaged)
    assert math.isnan(found.speed) == (not completed)
    assert found.idle_power == pytest.approx(0.8)
    assert completed or found.reasons == ("no cycle was completed",)


def test_distance_counts_from_the_onset():
    assert distance(RUN, record()) == pytest.approx(
        10 * 0.01 * 4.0 + 0.01 * (8.5 + 399 / 30 - 14.0)
    )
    assert math.isnan(distance(replace(RUN, onset=None), record()))
    assert math.isnan(distance(RUN, RunRecord()))
