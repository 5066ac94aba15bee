# SPDX-License-Identifier: Apache-2.0
"""The table and the recording of a simulated gait."""

import csv
import json

import numpy as np
import pytest

from worm_model.commands import replay
from worm_model.commands import simulate as command
from worm_model.gait import Gait
from worm_model.simulation.simulator import evaluate_gait

COLUMNS = (
    "time_s,length_change_m,rear_position_m,front_position_m,rear_anchor_m,front_anchor_m,"
    "cable_force_N,power_W,energy_J"
)


def test_the_table_holds_the_gait_from_its_onset_to_its_end(run, tmp_path):
    path = tmp_path / "gait.csv"
    arguments = ("--stroke", 0.07, "--frequency", 0.2, "--json", "--output", path)
    status, reported, _ = run(command, *arguments)
    assert status == 0
    assert path.read_text().splitlines()[0] == COLUMNS
    rows = np.array(list(csv.reader(path.open()))[1:], float)
    assert rows.shape == (2501, 9)  # five cycles of 5 s at 100 Hz
    assert np.all(rows[0, [0, 1, 2, 8]] == 0.0)
    result = evaluate_gait(Gait(0.07, 0.2))
    assert (rows[-1, 2] - rows[1000, 2]) / 15.0 == pytest.approx(result.speed, rel=1e-9)
    assert (rows[-1, 8] - rows[1000, 8]) / 15.0 == pytest.approx(result.power, rel=1e-9)
    assert json.loads(reported)["speed"] == pytest.approx(result.speed)
    status, _, error = run(command, *arguments)
    assert status == 2
    assert "exists already" in error


def test_a_period_that_is_no_multiple_of_the_step_does_not_run_over_the_end(run, tmp_path):
    path = tmp_path / "gait.csv"
    arguments = ("--stroke", 0.07, "--frequency", 0.3, "--cycles", 1, "--rate", 7, "--output", path)
    assert run(command, *arguments)[0] == 0
    times = np.array([row.split(",")[0] for row in path.read_text().splitlines()[1:]], float)
    assert times == pytest.approx(np.arange(24) / 7.0)


def test_the_recording_is_that_of_a_robot_like_the_twin(run, tmp_path):
    path = tmp_path / "gait.mcap"
    arguments = ("--stroke", 0.07, "--frequency", 0.4, "--cycles", 3, "--output", path)
    assert run(command, *arguments)[0] == 0
    report = json.loads(run(replay, path, "--json")[1])
    assert [cycle["complete"] for cycle in report["cycles"]] == [True] * 3
    assert report["x1_rmse"] < 1e-4
    assert abs(report["energy_error"]) < 0.01
