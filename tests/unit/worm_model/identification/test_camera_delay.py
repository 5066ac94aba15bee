# SPDX-License-Identifier: Apache-2.0
"""The camera's delay, distinguished from a lag of the servo."""

from dataclasses import asdict, replace

import numpy as np
import pytest
from virtual_campaign import TICK, Instruments, exact_run, run_of

from worm_driver.virtual_robot.offline_run import run_offline
from worm_driver.virtual_robot.virtual_settings import load_settings
from worm_model.gait import Gait
from worm_model.identification.actuation_stage import identify_actuation
from worm_model.identification.camera_delay import camera_delay, servo_lag
from worm_model.identification.data.observed_run import Recording, recording_of
from worm_model.parameters import PAPER, Parameters

GAITS = (Gait(0.07, 0.2), Gait(0.08, 0.25))
LAG, LATE = 0.012, 0.021  # s, of the servo and of the camera's stamps


def recordings(lag: float, late: float) -> list[Recording]:
    """Return runs of a servo with a lag (s) and a recorded encoder, and of a camera with a delay of its stamps (s).

    The servo does not yield to the cable force.
    """
    found = []
    for seed, gait in enumerate(GAITS):
        instruments = Instruments(camera_behind=-lag - late, power_behind=-lag)
        run = recording_of(exact_run(gait, instruments=instruments, seed=seed), f"run_{seed}")
        time = run.command_time
        cable = np.interp(time - lag, time, run.command)
        found.append(replace(run, cable_time=time, cable=cable))
    return found


def delay_of(runs: list[Recording]):
    return camera_delay(runs, identify_actuation(runs, np.random.default_rng(0)), PAPER)


def test_a_late_camera_is_reported_without_the_lag_of_the_servo():
    late = delay_of(recordings(LAG, LATE))
    assert late.low < LATE < late.high
    assert late.value == pytest.approx(LATE, abs=2e-3)
    assert late.note == f"add {late.value:+.4f} s to delay_s in the tracker's setup file"
    in_time = delay_of(recordings(LAG, 0.0))
    assert in_time.low < 0.0 < in_time.high
    assert "no change" in in_time.note


@pytest.mark.parametrize("gait", GAITS)
def test_the_yield_of_the_servo_is_no_lag(gait):
    """The virtual servo lags by its two control loops, 26 ms, and yields by up to 3 mm."""
    settings = load_settings()
    offline = run_offline(settings, gait.length_change, 10.0)
    run = recording_of(run_of(offline, gait, settings), "run")
    metres = -settings.cable_servos[0].spool_radius * TICK
    turned = np.interp(
        run.command_time, offline.servo_time - offline.onset, offline.encoder_ticks * metres
    )
    yielding = replace(run, cable_time=run.command_time, cable=turned)
    assert np.abs(turned - run.command).max() > 0.003
    truth = Parameters(**asdict(offline.truth))
    assert servo_lag(yielding, truth) == pytest.approx(0.026, abs=0.006)


def test_without_an_encoder_both_explanations_are_named():
    plain = [
        replace(run, cable_time=np.empty(0), cable=np.empty(0)) for run in recordings(LAG, LATE)
    ]
    assert np.isnan(servo_lag(plain[0], PAPER))
    untold = delay_of(plain)
    assert not untold.identifiable
    assert "record body_length/cable" in untold.note
    assert "33." in untold.note or "32." in untold.note
