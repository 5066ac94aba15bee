# SPDX-License-Identifier: Apache-2.0
"""Offline replay of a bag through the twin."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from recorded_run import GAIT, REST_S, simulated_run, write_bag
from rosbags.highlevel import AnyReader

from worm_model.analysis.replay_metrics import report_replay
from worm_model.bags.formats.bag_writer import new_bag
from worm_model.bags.opening import open_bag
from worm_model.bags.run_reader import read_run
from worm_model.bags.run_writer import write_run
from worm_model.commands import replay
from worm_model.parameters import PAPER
from worm_model.run import GaitStates, Run
from worm_model.twin.offline_replay import replay_run

CYCLES = 3
RUN = simulated_run(CYCLES)
KEYS = {"x1_rmse", "length_rmse", "power_rmse", "energy_error", "cycles", "real_time_factor"}


@pytest.fixture(scope="module")
def bag(tmp_path_factory) -> Path:
    return write_bag(tmp_path_factory.mktemp("bags") / "bag", RUN)


def test_the_twin_follows_a_robot_of_its_own_kind(bag: Path, run):
    """The recorded motion is the simulator's: only the added noise remains."""
    status, out, _ = run(replay, bag, "--json")
    report = json.loads(out)
    assert status == 0
    assert report.keys() >= KEYS
    assert report["x1_rmse"] < 4e-4
    assert report["length_rmse"] < 4e-4
    assert report["power_rmse"] < 0.5
    assert abs(report["energy_error"]) < 0.03
    assert [round(c["start"], 6) for c in report["cycles"]] == [
        round(REST_S + k * GAIT.period, 6) for k in range(CYCLES)
    ]
    for cycle in report["cycles"]:
        assert cycle["complete"]
        assert abs(cycle["x1_residual"]) < 4e-4
        assert cycle["grooves"] == pytest.approx(cycle["measured_grooves"], abs=1.0)
    assert sum(c["grooves"] for c in report["cycles"]) > CYCLES


def test_another_robot_differs(bag: Path, tmp_path: Path, run):
    parameters = tmp_path / "robot.yaml"
    parameters.write_text("idle_power: 1.82\ngain: 0.80\n")
    report = json.loads(run(replay, bag, "--parameters", parameters, "--json")[1])
    assert report["energy_error"] < -0.05
    assert report["length_rmse"] > 1e-3


def test_the_twins_topics_are_written_next_to_the_original_ones(bag: Path, tmp_path: Path, run):
    assert run(replay, bag, "--output", tmp_path / "both")[0] == 0
    offline = replay_run(RUN, PAPER)
    with open_bag(bag) as before, open_bag(tmp_path / "both") as after:
        assert before.topics.keys() < after.topics.keys()
        for topic in before.topics:
            assert list(before.messages([topic])) == list(after.messages([topic]))
        assert after.metadata["worm_run"] == before.metadata["worm_run"]
        estimated = read_run(after).estimated
    assert estimated.stamp.tolist() == offline.lengths["stamp_ns"].tolist()
    np.testing.assert_array_equal(estimated.length, offline.lengths["length"])
    with AnyReader([tmp_path / "both"]) as reader:
        found = {"/worm/twin/state": [], "/worm/twin/residuals": []}
        for connection, time, data in reader.messages():
            if connection.topic in found:
                found[connection.topic].append((time, reader.deserialize(data, connection.msgtype)))
    states = [message for _, message in found["/worm/twin/state"]]
    assert [m.rear_position for m in states] == offline.states["rear_position"].tolist()
    assert [m.rear_groove for m in states] == offline.states["rear_groove"].tolist()
    assert len(found["/worm/twin/residuals"]) == len(offline.residuals["stamp_ns"])


def test_a_replayed_bag_is_replayed_again(bag: Path, tmp_path: Path, run):
    """The recorded topics of the twin are replaced: the result is the same bag."""
    assert run(replay, bag, "--output", tmp_path / "a")[0] == 0
    assert run(replay, tmp_path / "a", "--output", tmp_path / "b")[0] == 0
    assert (tmp_path / "a/a_0.mcap").read_bytes() == (tmp_path / "b/b_0.mcap").read_bytes()


def test_two_robots_in_a_bag_are_distinguished(tmp_path: Path, run):
    with new_bag(tmp_path / "two") as writer:
        write_run(writer, RUN, "/one")
        write_run(writer, RUN, "/two")
    status, _, error = run(replay, tmp_path / "two")
    assert status == 2
    assert "choose with --namespace" in error
    assert run(replay, tmp_path / "two", "--namespace", "/two")[0] == 0


def test_without_a_gait_state_everything_is_judged_and_no_cycles_are_claimed():
    run = dataclasses.replace(RUN, gait_state=GaitStates())
    report = report_replay(run, replay_run(run, PAPER), PAPER.pitch)
    assert report.cycles == ()
    assert np.isfinite(report.residuals.x1_rmse)


def test_without_measurements_there_are_no_residuals():
    run = Run(origin=RUN.origin, commanded=RUN.commanded, gait_state=RUN.gait_state)
    offline = replay_run(run, PAPER)
    report = report_replay(run, offline, PAPER.pitch)
    assert len(offline.states["stamp_ns"]) > 100
    assert np.isnan(report.residuals.x1_rmse)
    assert np.isnan(report.energy_error)
    assert report.cycles[0].grooves > 0
