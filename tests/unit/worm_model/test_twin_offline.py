# SPDX-License-Identifier: Apache-2.0
"""The twin all at once against the twin sample by sample."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from recorded_run import EPOCH, GAIT, REST_S, simulated_run

from worm_model.lab_logs import LabSettings, read_lab_run
from worm_model.parameters import PAPER, Parameters
from worm_model.replay_metrics import report_replay
from worm_model.run import LengthSamples, PowerSamples, Run, TrackerSamples
from worm_model.twin.offline import predict_run
from worm_model.twin.replay import replay_run

RUN = simulated_run(cycles=3)
ONSET = EPOCH + round(REST_S * 1e9)
CHANNELS = ("rear_position", "length", "power", "energy")


def check_equal(run: Run, parameters: Parameters = PAPER) -> None:
    """All residuals from the last onset on, and the grooves, agree to rounding."""
    one, other = predict_run(run, parameters), replay_run(run, parameters)
    assert one is not None
    onset = int(run.gait_state.onset.max())
    for channel in CHANNELS:
        stamps, values = [], []
        for residuals in (one.residuals, other.residuals):
            known = np.isfinite(residuals[channel]) & (residuals["stamp_ns"] >= onset)
            order = np.argsort(residuals["stamp_ns"][known], kind="stable")
            stamps.append(residuals["stamp_ns"][known][order].tolist())
            values.append(residuals[channel][known][order])
        assert stamps[0] == stamps[1], channel
        np.testing.assert_allclose(values[0], values[1], rtol=1e-9, atol=1e-11, err_msg=channel)
    grooves = dict(zip(one.states["stamp_ns"].tolist(), one.states["rear_groove"], strict=True))
    after = other.states["stamp_ns"] > onset
    stepped = zip(other.states["stamp_ns"][after], other.states["rear_groove"][after], strict=True)
    assert [grooves[int(stamp)] for stamp, _ in stepped] == other.states["rear_groove"][
        after
    ].tolist()
    reports = [report_replay(run, followed, parameters.pitch) for followed in (one, other)]
    assert [c.grooves for c in reports[0].cycles] == [c.grooves for c in reports[1].cycles]
    np.testing.assert_allclose(reports[0].energy_error, reports[1].energy_error, rtol=1e-9)


def without(samples, chosen):
    """Samples but for the chosen ones."""
    return type(samples)(**{name: values[~chosen] for name, values in vars(samples).items()})


def blind(run: Run, start: float, end: float) -> Run:
    """No measured length between two times, s after the onset."""
    time = (run.measured.stamp - ONSET) * 1e-9
    return replace(run, measured=without(run.measured, (time > start) & (time < end)))


def doubled(run: Run) -> Run:
    """Every third measured length comes twice, the second one wrong."""
    stamp = np.sort(np.concatenate([run.measured.stamp, run.measured.stamp[::3]]))
    row = np.searchsorted(run.measured.stamp, stamp)
    again = np.concatenate([[False], np.diff(stamp) == 0])
    wrong = np.where(again, 0.01, 0.0)
    length = run.measured.length[row] + wrong
    return replace(
        run, measured=LengthSamples(stamp, length, run.measured.length_change[row] + wrong)
    )


def shifted(run: Run, distance: float, start: float) -> Run:
    """The robot slides by a distance at a time, s after the onset."""
    later = (run.tracker.stamp - ONSET) * 1e-9 > start
    tracker = replace(
        run.tracker,
        rear_position=run.tracker.rear_position + distance * later,
        front_position=run.tracker.front_position + distance * later,
    )
    return replace(run, tracker=tracker)


def told(run: Run, delay_ns: int) -> Run:
    """The driver tells of the run at another time than its onset."""
    stamp = run.gait_state.stamp.copy()
    stamp[1] += delay_ns
    return replace(run, gait_state=replace(run.gait_state, stamp=stamp))


def invalid_power(run: Run) -> Run:
    status = run.power.status.copy()
    status[100:140] = 3
    return replace(run, power=replace(run.power, status=status))


def unseen(run: Run, start: float, end: float) -> Run:
    """No tracker between two times, s after the onset."""
    time = (run.tracker.stamp - ONSET) * 1e-9
    return replace(run, tracker=without(run.tracker, (time > start) & (time < end)))


def after_another(run: Run) -> Run:
    """The driver told of another run before this one."""
    rows = {}
    for name, values in vars(run.gait_state).items():
        before = (
            values[:2] - 20 * 10**9 * (values[:2] > 0) if name in ("stamp", "onset") else values[:2]
        )
        rows[name] = np.concatenate([before, values])
    return replace(run, gait_state=replace(run.gait_state, **rows))


VARIANTS: dict[str, Callable[[], Run]] = {
    "as it is": lambda: RUN,
    "no measured length at all": lambda: replace(RUN, measured=LengthSamples()),
    "no measured length after the onset": lambda: blind(RUN, -0.01, 99.0),
    "a gap that the estimate bridges": lambda: blind(RUN, 1.0, 2.2),
    "a short gap": lambda: blind(RUN, 1.0, 1.15),
    "several gaps": lambda: blind(blind(blind(RUN, 0.5, 0.9), 3.0, 3.3), 6.0, 7.5),
    "a gap at the end": lambda: blind(RUN, 7.0, 99.0),
    "duplicates": lambda: doubled(RUN),
    "a missed groove": lambda: shifted(RUN, -PAPER.pitch, 3.2),
    "a missed groove in the last cycle": lambda: shifted(RUN, -PAPER.pitch, 6.0),
    "a missed groove while the tracker is away": lambda: unseen(
        shifted(RUN, -PAPER.pitch, 3.2), 2.8, 4.0
    ),
    "an extra groove": lambda: shifted(RUN, PAPER.pitch, 1.0),
    "a slip of no whole groove": lambda: shifted(RUN, 0.4 * PAPER.pitch, 1.0),
    "no power": lambda: replace(RUN, power=PowerSamples()),
    "power without readings": lambda: invalid_power(RUN),
    "told of before the onset": lambda: told(RUN, -30_000_000),
    "told of after the onset": lambda: told(RUN, 30_000_000),
    "other noise": lambda: simulated_run(cycles=2, seed=7),
}


@pytest.mark.parametrize("variant", VARIANTS)
def test_both_agree(variant: str):
    check_equal(VARIANTS[variant]())


@pytest.mark.parametrize(
    "changes",
    [{"gain": 0.7, "slack": 0.002}, {"front_mass": 0.9, "time_constant": 0.4}, {"pitch": 0.02}],
)
def test_both_agree_on_other_robots(changes: dict[str, float]):
    check_equal(RUN, PAPER.replace(**changes))


@pytest.mark.parametrize("number", range(1, 9))
def test_both_agree_on_the_campaign(shared: Path, number: int):
    folder = shared / "campaign" / f"run_{number:02}"
    check_equal(read_lab_run(folder, LabSettings(epoch=EPOCH)).run)


IRREGULAR: dict[str, Callable[[], Run]] = {
    "no gait state": lambda: Run(commanded=RUN.commanded, measured=RUN.measured),
    "heard of late": lambda: told(RUN, 200_000_000),
    "a tracker that jumps": lambda: shifted(RUN, 0.2, 3.0),
    "a tracker that was not there": lambda: replace(RUN, tracker=TrackerSamples()),
    "a tracker that is away for long": lambda: unseen(RUN, 3.0, 5.2),
    "a tracker that goes away": lambda: unseen(RUN, 5.0, 99.0),
    "a second run": lambda: after_another(RUN),
    "no command": lambda: replace(RUN, commanded=LengthSamples()),
    "neither command nor length for long": lambda: replace(
        blind(RUN, 2.0, 5.0),
        commanded=without(
            RUN.commanded, np.abs(RUN.commanded.stamp - ONSET - 35 * 10**8) < 15 * 10**8
        ),
    ),
}


@pytest.mark.parametrize("variant", IRREGULAR)
def test_irregular_runs_are_left_to_the_samples(variant: str):
    assert predict_run(IRREGULAR[variant](), PAPER) is None


def test_the_run_of_these_tests_gains_grooves():
    prediction = predict_run(RUN, PAPER)
    assert prediction is not None
    assert prediction.states["rear_groove"][-1] >= 3
    assert (RUN.measured.stamp[-1] - ONSET) * 1e-9 > 3 * GAIT.period
