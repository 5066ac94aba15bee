# SPDX-License-Identifier: Apache-2.0
"""Traces of a recorded run are its latest samples on a time grid, and NaN without recent ones."""

import math
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from recorded_run import REST_S, simulated_run, write_bag

from worm_model.errors import InputError
from worm_model.parameters import PAPER
from worm_model.run import Run
from worm_model.twin.offline_replay import Replay, replay_run
from worm_optimizer.console import run_traces
from worm_optimizer.console.run_traces import LATEST_S, POINTS, RunTraces, traces_of


@pytest.fixture(scope="module")
def run() -> Run:
    return simulated_run()


@pytest.fixture(scope="module")
def traces(run: Run) -> RunTraces:
    return traces_of(run, replay_run(run, PAPER), PAPER)


def test_time_counts_from_the_onset(traces: RunTraces, run: Run):
    assert traces.time_s[0] == pytest.approx(-REST_S, abs=0.01)
    assert np.all(np.diff(traces.time_s) > 0.0)
    assert len(traces.time_s) <= POINTS
    assert traces.row_at(-99.0) == 0
    assert traces.row_at(99.0) == len(traces.time_s) - 1


def test_a_value_is_the_latest_sample(traces: RunTraces, run: Run):
    seconds = (run.commanded.stamp - run.commanded.stamp[0]) * 1e-9 - REST_S
    for time_s in (-0.5, 0.333, 2.0):
        row = traces.row_at(time_s)
        sample = np.searchsorted(seconds, traces.time_s[row] + 1e-6, "right") - 1
        assert traces.traces["commanded"][row] == run.commanded.length[sample]


def test_without_recent_samples_there_is_no_value(traces: RunTraces):
    assert np.isnan(traces.traces["cable"]).all()
    stamp = np.array([0, 10**9])
    grid = np.arange(0, 2 * 10**9, 10**8)
    values = run_traces._at(grid, stamp, np.array([1.0, 2.0]), 0.1)
    known = np.isfinite(values)
    assert np.array_equal(known, (grid - np.where(grid < 10**9, 0, 10**9)) * 1e-9 <= LATEST_S + 0.1)


def test_the_picture_shows_robot_and_twin_at_the_time(traces: RunTraces):
    assert "not seen" not in traces.picture_at(1.0)
    assert traces.picture_at(0.0) != traces.picture_at(2.0)
    nan = np.full(len(traces.time_s), math.nan)
    hidden = replace(traces, traces={**traces.traces, "x1": nan, "x2": nan})
    assert "not seen" in hidden.picture_at(1.0)
    before = np.flatnonzero(np.isnan(traces.twin["rear_position"]))
    assert "no data of the twin" in traces.picture_at(float(traces.time_s[before[0]]))


def test_the_output_of_the_program_is_read_back(
    traces: RunTraces,
    run: Run,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
):
    bag = write_bag(tmp_path / "bag", run)
    monkeypatch.setattr(sys, "argv", ["run_traces", str(bag)])
    assert run_traces.main() == 0
    read = RunTraces.from_json("bag", capsys.readouterr().out)
    assert read.parameters == PAPER
    for name, values in traces.traces.items():
        assert read.traces[name] == pytest.approx(values, abs=1e-6, nan_ok=True), name
    assert read.picture_at(1.0) == traces.picture_at(1.0)


def test_a_recording_without_samples_is_rejected():
    nothing = Replay(
        {n: np.empty(0) for n in ("stamp_ns", *run_traces._TWIN, "length", "power")}, {}, {}
    )
    with pytest.raises(InputError, match="empty_bag"):
        traces_of(Run(), nothing, PAPER, "empty_bag")
    assert math.isnan(run_traces._at(np.array([0]), np.empty(0, np.int64), np.empty(0), 1.0)[0])
