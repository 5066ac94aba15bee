# SPDX-License-Identifier: Apache-2.0
"""The metrics of a run: averaged cycles, mean rates, energy, idle power; and the driver's metrics of the same data."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from recorded_run import GAIT, simulated_run

from worm_driver.gait import gait_limits, gait_metrics, gait_player
from worm_driver.power.ina219 import PowerSample, SampleStatus
from worm_model.analysis import run_metrics
from worm_model.gait import Gait
from worm_model.parameters import PAPER
from worm_model.run import Activity, GaitStates, PowerSamples, Run
from worm_model.simulation.simulator import cost_of_transport
from worm_msgs.robot_parameters import STANDARD_GRAVITY, RobotParameters

INACTIVE, IDLE, RESTING, RUNNING, STOPPING, FAULT = Activity
EPOCH = 1_700_000_000_000_000_000  # ns
MASS = PAPER.mass


def gait_states(state, onset, cycles, **more):
    count = len(state)
    rows = {
        "state": np.array(state),
        "onset": np.array(onset, np.int64),
        "cycle": np.arange(count),
        "cycles": np.full(count, cycles),
        **more,
    }
    return GaitStates.of(Gait(0.07, 0.2), EPOCH + np.arange(count, dtype=np.int64), **rows)


def stamps(seconds):
    return EPOCH + np.round(np.asarray(seconds) * 1e9).astype(np.int64)


def test_the_last_three_of_five_cycles_are_averaged():
    states = gait_states([INACTIVE, RESTING, RUNNING, RUNNING], [0, 0, EPOCH, EPOCH], 5)
    played = run_metrics.last_played_gait(states)
    assert played.cycle_window(3, 5) == run_metrics.Window(
        EPOCH + 10_000_000_000, EPOCH + 25_000_000_000
    )
    assert played.cycle_window(3, 5).duration == 15.0
    assert run_metrics.averaged_cycles(Run(gait_state=states), played) == (3, 5)


@pytest.mark.parametrize(
    ("states", "times", "reason", "averaged"),
    [  # 5 s per cycle
        ((RUNNING, FAULT), (5.0, 11.0), "ended in FAULT after 2 of 5 cycles", (1, 2)),
        ((RUNNING, STOPPING), (5.0, 11.0), "stopped after 2 of 5 cycles", (1, 2)),
        ((RUNNING, IDLE), (5.0, 11.0), "ended (idle) after 2 of 5 cycles", (1, 2)),
        # The two topics have different clocks, a tenth of a second apart: the third cycle was complete.
        ((RUNNING, IDLE), (5.0, 14.9), "ended (idle) after 3 of 5 cycles", (1, 3)),
        # A gait that is stopped plays on to its next point of rest.
        ((STOPPING, IDLE), (11.0, 15.0 - 1e-9), "stopped after 3 of 5 cycles", (1, 3)),
        ((STOPPING, FAULT), (11.0, 15.0 - 1e-9), "ended in FAULT after 3 of 5 cycles", (1, 3)),
    ],
)
def test_an_early_end_is_reported_with_the_cycles_that_were_played(states, times, reason, averaged):
    reported = gait_states([RESTING, RUNNING, *states], [0, EPOCH, EPOCH, EPOCH], 5)
    reported = dataclasses.replace(reported, stamp=stamps([-1.0, 0.0, *times]))
    run, played = Run(gait_state=reported), run_metrics.last_played_gait(reported)
    assert run_metrics.early_end(run, played) == reason
    assert run_metrics.averaged_cycles(run, played) == averaged


@pytest.mark.parametrize(("cycles", "whole"), [(0.5, 0), (1.5, 1)])
def test_a_recording_that_ends_before_the_gait_names_its_complete_cycles(cycles, whole):
    run = simulated_run(3)
    played = run_metrics.last_played_gait(run.gait_state)
    end = played.onset + round(cycles * GAIT.period * 1e9)
    recorded = run.power.stamp < end
    fields = dataclasses.fields(run.power)
    power = PowerSamples(*(getattr(run.power, field.name)[recorded] for field in fields))
    early = dataclasses.replace(run, power=power)
    assert f"{whole} of 3 cycles" in run_metrics.early_end(early, played)


NEAR = [EPOCH, EPOCH + 1, EPOCH + 2, EPOCH + 3]
STEPPED = [EPOCH, EPOCH + 10**9, EPOCH + 10**9, EPOCH + 10**9]


@pytest.mark.parametrize(
    ("onsets", "numbers", "cycles", "runs"),
    [
        pytest.param(NEAR, [1, 1, 2, 2], [0, 1, 2, 3], [[0, 1], [2, 3]], id="numbers decide"),
        pytest.param(STEPPED, [7, 7, 7, 7], [0, 1, 2, 3], [[0, 1, 2, 3]], id="not the onsets"),
        pytest.param(NEAR, [1, 1, 1, 1], [1, 2, 1, 2], [[0, 1], [2, 3]], id="restarted driver"),
        pytest.param(
            [EPOCH, EPOCH + 60_000_000, EPOCH + 60 * 10**9, EPOCH + 60 * 10**9],
            [0, 0, 0, 0],
            [0, 1, 2, 3],
            [[0, 1], [2, 3]],
            id="onsets without numbers",
        ),
    ],
)
def test_runs_are_distinguished(onsets, numbers, cycles, runs):
    states = gait_states([RUNNING] * 4, onsets, 5, run=np.array(numbers), cycle=np.array(cycles))
    assert [rows.tolist() for rows in states.rows_of_runs()] == runs


def performance(
    position, energy, window: run_metrics.Window, direction: int
) -> tuple[float, float, float]:
    """Return speed in m/s, power in W and cost of transport over a window."""
    speed = direction * run_metrics.mean_rate(position, window, "position of x1")
    power = run_metrics.mean_rate(energy, window, "power")
    return speed, power, float(cost_of_transport(speed, power, MASS))


@given(
    speed=st.floats(-0.05, 0.05).filter(lambda v: abs(v) > 1e-4),
    power=st.floats(0.1, 40.0),
    phase=st.floats(0.0, 0.03),
    direction=st.sampled_from([1, -1]),
)
def test_steady_motion_gives_its_speed_and_power_at_any_phase_of_the_samples(
    speed, power, phase, direction
):
    time = np.arange(0.0, 30.0, 1.0 / 30.0) + phase
    window = run_metrics.Window(EPOCH + 5_000_000_000, EPOCH + 20_000_000_000)
    energy = run_metrics.accumulated_energy((stamps(time), np.full(time.size, power)))
    moved = performance((stamps(time), 0.3 + speed * time), energy, window, direction)
    assert moved[:2] == pytest.approx((direction * speed, power), rel=1e-6)
    # a robot that moves backwards transports nothing
    cost = power / (MASS * STANDARD_GRAVITY * abs(speed)) if direction * speed > 0.0 else math.inf
    assert moved[2] == pytest.approx(cost)


def test_samples_that_are_missing_do_not_count():
    time = np.arange(0.0, 30.0, 0.1)
    power = np.full(time.size, 2.0)
    position = 0.01 * time
    power[50:60] = math.nan
    position[97:103] = math.nan
    window = run_metrics.Window(EPOCH + 10_000_000_000, EPOCH + 20_000_000_000)
    energy = run_metrics.accumulated_energy((stamps(time), power))
    assert performance((stamps(time), position), energy, window, 1)[:2] == pytest.approx(
        (0.01, 2.0)
    )


@pytest.mark.parametrize("name", ["position of x1", "power"])
def test_a_recording_that_ends_too_early_is_rejected(name):
    long, short = np.arange(0.0, 30.0, 0.1), np.arange(0.0, 12.0, 0.1)
    series = {"position of x1": (stamps(long), long), "power": (stamps(long), long)}
    series[name] = (stamps(short), short)
    window = run_metrics.Window(EPOCH, EPOCH + 20_000_000_000)
    with pytest.raises(run_metrics.RecordingError, match=f"no {name} over the averaged cycles"):
        performance(series["position of x1"], series["power"], window, 1)


def driver_figures(run: Run, cycles: int) -> gait_metrics.RunMetrics:
    """Return the driver's metrics of a recorded run, with the driver's clock at 0 at the first sample."""

    def clock(stamp: np.ndarray) -> list[float]:
        return ((stamp - run.origin) * 1e-9).tolist()

    seen = np.isfinite(run.tracker.rear_position)
    positions = zip(clock(run.tracker.stamp[seen]), run.tracker.rear_position[seen], strict=True)
    power = zip(clock(run.power.stamp), run.power.bus_voltage, run.power.current, strict=True)
    record = gait_metrics.RunRecord(
        positions=[(time, float(x1)) for time, x1 in positions],
        power=[PowerSample(time, SampleStatus.VALID, float(u), float(i)) for time, u, i in power],
    )
    played = run_metrics.last_played_gait(run.gait_state)
    onset = (played.onset - run.origin) * 1e-9
    gait = gait_limits.Gait(GAIT.stroke, GAIT.frequency, GAIT.direction)
    ended = gait_player.PlayedRun(
        1, gait, cycles, cycles, rest_start=0.0, onset=onset, end=onset + cycles * GAIT.period
    )
    return gait_metrics.run_metrics(ended, record, RobotParameters())


@pytest.mark.parametrize("cycles", [2, 5])
def test_the_driver_measures_the_same_of_the_same_run(cycles: int):
    """The driver may not import this package: here its protocol and constants are compared."""
    run = simulated_run(cycles)
    played = run_metrics.last_played_gait(run.gait_state)
    first, last = run_metrics.averaged_cycles(run, played)
    speed, power, cost = performance(
        (run.tracker.stamp, run.tracker.rear_position),
        run_metrics.accumulated_energy((run.power.stamp, run.power.valid_power)),
        played.cycle_window(first, last),
        GAIT.direction,
    )
    theirs = driver_figures(run, cycles)
    assert (theirs.cycles_completed, theirs.cycles_averaged) == (last, last - first + 1)
    assert theirs.speed == pytest.approx(speed, rel=1e-9)
    # rectangle rule compared with trapezoidal rule
    assert theirs.power == pytest.approx(power, rel=2e-3)
    assert theirs.cost_of_transport == pytest.approx(cost, rel=2e-3)
    assert theirs.idle_power == pytest.approx(run_metrics.idle_power(run, played), rel=1e-12)
    constants = gait_metrics.AVERAGED_CYCLES, gait_metrics.IDLE_SAMPLES
    assert constants == (run_metrics.AVERAGED_CYCLES, run_metrics.IDLE_SAMPLES)


def test_idle_power_needs_ten_samples_and_a_rest_that_was_reported():
    run = simulated_run(2)
    played = run_metrics.last_played_gait(run.gait_state)
    assert run_metrics.idle_power(run, played) == pytest.approx(
        run.power.power[:10].mean(), rel=1e-12
    )
    late = dataclasses.replace(played, rest_start=played.onset - 150_000_000)
    assert math.isnan(run_metrics.idle_power(run, late))
    assert math.isnan(run_metrics.idle_power(run, dataclasses.replace(played, rest_start=None)))
