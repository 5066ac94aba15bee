# SPDX-License-Identifier: Apache-2.0
"""The command recover."""

import json
import shutil
from pathlib import Path

import pytest
from recorded_run import simulated_run, write_bag

from worm_model.bags.formats.bag_writer import new_bag
from worm_model.bags.opening import open_bag
from worm_model.bags.operations.copies import recover as recover_bag
from worm_model.commands import recover

RUN = simulated_run(cycles=1)


@pytest.fixture
def cut(tmp_path: Path) -> Path:
    """Return a bag whose file ends in the middle of a chunk, and whose metadata.yaml is missing."""
    bag = write_bag(tmp_path / "bag", RUN)
    (bag / "metadata.yaml").unlink()
    file = bag / "bag_0.mcap"
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2 + 100])
    return bag


def test_it_reports_the_saved_messages(cut: Path, tmp_path: Path, run):
    before = (cut / "bag_0.mcap").read_bytes()
    status, out, _ = run(recover, cut, "--output", tmp_path / "saved", "--json")
    assert status == 0
    report = json.loads(out)
    with open_bag(tmp_path / "saved") as bag:
        assert bag.message_count == report["messages"]
        assert bag.metadata["worm_run"]["made_by"] == "tests/helpers/recorded_run.py"
        assert bag.metadata["worm_recovery"]["loss"] == report["loss"]
    assert "bag_0.mcap: it was not closed" in report["loss"]
    assert (cut / "bag_0.mcap").read_bytes() == before
    assert not (cut / "metadata.yaml").exists()


def test_a_whole_file_without_metadata_loses_nothing(tmp_path: Path, run):
    bag = write_bag(tmp_path / "bag", RUN)
    assert run(recover, bag / "bag_0.mcap", "--output", tmp_path / "saved")[0] == 0
    with open_bag(bag) as one, open_bag(tmp_path / "saved") as other:
        assert list(one.messages()) == list(other.messages())
        assert {t.name: t.metadata for t in one.topics.values()} == {
            t.name: t.metadata for t in other.topics.values()
        }


def test_the_second_recovery_overwrites_nothing(cut: Path, run):
    assert run(recover, cut)[0] == 0
    status, _, error = run(recover, cut)
    assert status == 2
    assert "exists already" in error


@pytest.mark.parametrize("name", ["no", "empty"])
def test_nothing_to_save_is_reported_in_one_line(tmp_path: Path, run, name: str):
    (tmp_path / "empty").mkdir()
    status, _, error = run(recover, tmp_path / name)
    assert (status, error.count("\n")) == (2, 1)


def test_every_gait_of_a_recording_is_kept_once(tmp_path: Path):
    with new_bag(tmp_path / "bag") as writer:
        for stroke in ("0.06", "0.07", "0.06"):
            writer.add_metadata("worm_gait", {"stroke": stroke, "onset_ns": "1"})
    recover_bag(tmp_path / "bag", tmp_path / "saved")
    with open_bag(tmp_path / "saved") as bag:
        gaits = [dict(record.values) for record in bag.records if record.name == "worm_gait"]
    assert [gait["stroke"] for gait in gaits] == ["0.06", "0.07"]


def test_names_with_a_dot_do_not_meet(cut: Path, tmp_path: Path):
    for name in ("pipe_0.25Hz", "pipe_0.30Hz"):
        shutil.copytree(cut, tmp_path / name)
        assert recover_bag(tmp_path / name, None)[0] == tmp_path / f"{name}_recovered"
    assert recover_bag(cut / "bag_0.mcap", None)[0] == cut / "bag_0_recovered"
