# SPDX-License-Identifier: Apache-2.0
"""A table of the recordings; parts of bags and joined bags."""

import errno
import json
import os
import shutil
from datetime import datetime, timedelta
from functools import partial
from pathlib import Path

import pytest

from worm_model.bags.formats.bag_writer import new_bag
from worm_model.bags.opening import open_bag
from worm_model.commands import bag_runs, bags
from worm_model.gait import Gait, named_values

SAMPLES = Path(__file__).resolve().parents[4] / "bags"


@pytest.fixture
def run(run, monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return partial(run, bags)


def test_the_table_lists_every_run_and_why_a_bag_has_none(run):
    before = sorted(SAMPLES.rglob("*"))
    status, reported, _ = run(SAMPLES, "--json")
    rows = {Path(row["bag"]).name: row for row in json.loads(reported)["runs"]}
    assert status == 0
    # and the recordings of the operator
    assert set(rows) >= {"faults", "forward", "killed", "reverse"}
    forward = rows["forward"]
    assert forward["gait"] == named_values(Gait(0.07, 0.25))
    assert forward["grooves_per_cycle"] == pytest.approx(1.0, abs=0.01)
    assert forward["state"] == "closed"
    assert forward["health"] == "healthy"
    assert rows["reverse"]["gait"]["direction"] == -1
    assert rows["reverse"]["speed"] > 0.0
    assert rows["killed"]["state"] == "not closed"
    assert rows["killed"]["gait"] is None
    assert "recover" in rows["killed"]["notes"]
    assert sorted(SAMPLES.rglob("*")) == before  # listing recovers no bag


def test_the_table_names_the_conditions_of_runs_that_have_some(run, tmp_path):
    assert "conditions" not in run(SAMPLES)[1]
    with open_bag(SAMPLES / "forward") as bag, new_bag(tmp_path / "bags" / "steep") as writer:
        writer.add_metadata("worm_run", {"slope_deg": "20.0"})
        for channel in bag.channels:
            writer.add_topic(channel)
        writer.write_all(bag.messages())
    assert "slope 20 deg" in run(tmp_path / "bags")[1]
    (row,) = json.loads(run(tmp_path / "bags", "--json")[1])["runs"]
    assert row["conditions"]["slope_deg"] == 20.0


def test_the_index_of_a_folder_does_not_depend_on_how_its_path_is_given(run, monkeypatch):
    monkeypatch.chdir(SAMPLES.parent)
    rows = json.loads(run("table", "bags", "--json")[1])["runs"]
    monkeypatch.setattr(bag_runs, "rows_of_bag", None)
    status, absolute, error = run("table", SAMPLES, "--json")
    assert (status, error) == (0, "")
    paths = [Path(row.pop("bag")) for row in rows]
    again = json.loads(absolute)["runs"]
    assert [Path(row.pop("bag")) for row in again] == [path.absolute() for path in paths]
    assert again == rows


@pytest.mark.parametrize("name", ["metadata.yaml", "forward_0.mcap"])
def test_a_bag_without_permission_is_unreadable_until_it_has_permission(
    run, monkeypatch, tmp_path, name
):
    shutil.copytree(SAMPLES / "forward", tmp_path / "forward")
    opened = Path.open

    def denied(path, *arguments, **options):
        if path.name == name:
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(path))
        return opened(path, *arguments, **options)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "open", denied)
        (row,) = json.loads(run(tmp_path, "--json")[1])["runs"]
        assert row["state"] == "unreadable"
        assert str(tmp_path / "forward" / name) in row["notes"]
    (row,) = json.loads(run(tmp_path, "--json")[1])["runs"]
    assert row["state"] == "closed"


def test_a_run_of_a_robot_whose_clock_is_slow_starts_by_the_clock_of_its_recorder(run, tmp_path):
    late = timedelta(seconds=20)
    shutil.copytree(SAMPLES / "forward", tmp_path / "on_time")
    with open_bag(SAMPLES / "forward") as bag, new_bag(tmp_path / "late") as writer:
        shift_ns = round(late.total_seconds() * 1e9)
        writer.write_all(m._replace(log_time=m.log_time + shift_ns) for m in bag.messages())
    rows = json.loads(run(tmp_path, "--json")[1])["runs"]
    starts = {Path(row["bag"]).name: datetime.fromisoformat(row["start"]) for row in rows}
    assert starts["late"] - starts["on_time"] == late


def test_a_bag_that_changed_is_read_again(run, tmp_path):
    shutil.copytree(SAMPLES / "forward", tmp_path / "bags" / "one")
    assert "70.0 mm 0.250 Hz" in run(tmp_path / "bags")[1]
    file = tmp_path / "bags" / "one" / "forward_0.mcap"
    file.write_bytes(file.read_bytes()[:-5000])
    assert "damaged" in run(tmp_path / "bags")[1]


def test_a_folder_without_bags_is_rejected(run, tmp_path):
    status, reported, error = run(tmp_path)
    assert (status, reported) == (2, "")
    assert "holds no bag" in error
    assert run(tmp_path / "none")[0] == 2


def test_info_lists_topics_and_metadata(run):
    content = json.loads(run("info", SAMPLES / "forward", "--json")[1])
    assert {topic["name"] for topic in content["topics"]} >= {"/worm/tracker", "/worm/power"}
    assert sum(topic["messages"] for topic in content["topics"]) == content["messages"]


def test_a_trimmed_bag_begins_with_the_last_messages_of_latched_topics(run, tmp_path):
    output = tmp_path / "part"
    arguments = ("--start", 8, "--end", 9, "--output", output)
    assert run("trim", SAMPLES / "forward", *arguments)[0] == 0
    with open_bag(SAMPLES / "forward") as whole, open_bag(output) as part:
        first = whole.start + 8 * 10**9
        expected = [m for m in whole.messages() if first <= m.log_time <= first + 10**9]
        found = list(part.messages())
        latched = [m for m in found if m not in expected]
        assert [m.topic for m in latched] == ["/worm/gait_state"]
        assert latched[0].log_time == first
        assert len(found) == len(expected) + 1
    assert run("trim", SAMPLES / "forward", *arguments)[0] == 2
    assert run("trim", SAMPLES / "forward", "--start", 1e4, "--output", tmp_path / "no")[0] == 2
    assert run("trim", SAMPLES / "forward", "--output", tmp_path / "no")[0] == 2


def test_a_filtered_bag_has_the_messages_of_its_topics(run, tmp_path):
    output = tmp_path / "part"
    topics = ("--topic", "/worm/power", "--topic", "/worm/gait_state")
    assert run("filter", SAMPLES / "forward", *topics, "--output", output)[0] == 0
    with open_bag(SAMPLES / "forward") as whole, open_bag(output) as part:
        assert sorted(part.topics) == ["/worm/gait_state", "/worm/power"]
        assert list(part.messages()) == list(whole.messages(part.topics))
        assert part.metadata["worm_run"] == whole.metadata["worm_run"]
    nothing = ("--output", tmp_path / "no")
    assert run("filter", SAMPLES / "forward", "--topic", "/no", *nothing)[0] == 2
    assert run("filter", SAMPLES / "forward", *topics, "--start", 1e4, *nothing)[0] == 2


def test_a_run_is_cut_out_by_its_number(run, tmp_path):
    output = tmp_path / "run"
    assert run("trim", SAMPLES / "forward", "--run", 1, "--output", output)[0] == 0
    with open_bag(SAMPLES / "forward") as whole, open_bag(output) as part:
        assert list(part.messages()) == list(whole.messages())
    assert run("trim", SAMPLES / "forward", "--run", 2, "--output", tmp_path / "no")[0] == 2
