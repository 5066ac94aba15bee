# SPDX-License-Identifier: Apache-2.0
"""Tables of a bag."""

import csv
import json
import math
import sys
from pathlib import Path

import numpy as np
import pytest
from recorded_run import simulated_run, write_bag

from worm_model.bags.bag_writer import BagWriter
from worm_model.bags.blocks import block_of_topics
from worm_model.bags.cdr import encode
from worm_model.bags.definitions import installed_types, topic_of
from worm_model.commands import export

RUN = simulated_run(cycles=1)


@pytest.fixture(scope="module")
def bag(tmp_path_factory) -> Path:
    return write_bag(tmp_path_factory.mktemp("bags") / "bag", RUN)


def command(monkeypatch: pytest.MonkeyPatch, *arguments: object) -> int:
    monkeypatch.setattr(sys, "argv", ["export", *map(str, arguments)])
    return export.main()


def table(path: Path) -> dict[str, list[str]]:
    with path.open(newline="") as stream:
        rows = list(csv.reader(stream))
    return {name: [row[i] for row in rows[1:]] for i, name in enumerate(rows[0])}


def test_csv_gives_the_numbers_back_exactly(bag: Path, tmp_path: Path, monkeypatch, capsys):
    assert command(monkeypatch, bag, "--output", tmp_path / "csv", "--json") == 0
    outcome = json.loads(capsys.readouterr().out)
    assert set(outcome["rows"]) == {p.name for p in (tmp_path / "csv").iterdir()}
    tracker = table(tmp_path / "csv" / "worm__tracker.csv")
    assert list(map(int, tracker["header.stamp_ns"])) == RUN.tracker.stamp.tolist()
    found = [float(cell) if cell else math.nan for cell in tracker["rear_position"]]
    np.testing.assert_array_equal(found, RUN.tracker.rear_position)
    states = table(tmp_path / "csv" / "worm__gait_state.csv")
    assert list(map(int, states["onset_ns"])) == RUN.gait_state.onset.tolist()
    assert set(states["message"]) == {""}


def test_parquet_keeps_the_types(bag: Path, tmp_path: Path, monkeypatch):
    parquet = pytest.importorskip("pyarrow.parquet")
    target = tmp_path / "tables"
    assert command(monkeypatch, bag, "--output", target, "--format", "parquet") == 0
    power = parquet.read_table(target / "worm__power.parquet")
    assert str(power.schema.field("power").type) == "double"
    assert str(power.schema.field("status").type) == "uint8"
    assert str(power.schema.field("header.stamp_ns").type) == "int64"
    assert power["power"].to_pylist() == RUN.power.power.tolist()
    assert power.num_rows == len(RUN.power.stamp)


def test_sequences_become_a_column_an_element(tmp_path: Path, monkeypatch):
    """Also if they grow within the bag: what a message lacks is an empty cell."""
    kind = "sensor_msgs/msg/JointState"
    few = encode(
        np.array([1, 2]),
        kind,
        installed_types(kind),
        {"position": np.array([[1.0], [2.0]])},
        {"name[0]": "a"},
    )
    more = encode(
        np.array([3]),
        kind,
        installed_types(kind),
        {"position": np.array([[3.0, 4.0]])},
        {"name[0]": "a", "name[1]": "b"},
    )
    with BagWriter(tmp_path / "bag") as writer:
        writer.add_topic(topic_of("/worm/joint_states", kind))
        for part in (few, more):
            writer.write_block(block_of_topics({"/worm/joint_states": part}))
    assert command(monkeypatch, tmp_path / "bag", "--output", tmp_path / "csv") == 0
    found = table(tmp_path / "csv" / "worm__joint_states.csv")
    assert found["position[0]"] == ["1.0", "2.0", "3.0"]
    assert found["position[1]"] == ["", "", "4.0"]
    assert found["name[0]"] == ["a", "a", "a"]
    assert found["name[1]"] == ["", "", "b"]
    assert found["log_time_ns"] == ["1", "2", "3"]


def test_only_the_topics_asked_for(bag: Path, tmp_path: Path, monkeypatch):
    target = tmp_path / "csv"
    assert command(monkeypatch, bag, "--output", target, "--topic", "/worm/power") == 0
    assert [p.name for p in target.iterdir()] == ["worm__power.csv"]


def test_a_topic_that_cannot_be_decoded_is_left_out_and_named(tmp_path: Path, monkeypatch, capsys):
    with BagWriter(tmp_path / "bag") as writer:
        for name in ("/worm/power", "/worm/bad"):
            writer.add_topic(topic_of(name, "worm_msgs/msg/Power"))
        power = encode(
            np.array([1]),
            "worm_msgs/msg/Power",
            installed_types("worm_msgs/msg/Power"),
            {"power": 1.0},
            {},
        )
        data = power.message(0)
        writer.write("/worm/power", data, 1, 1)
        writer.write("/worm/bad", data[:-9], 2, 2)
    assert command(monkeypatch, tmp_path / "bag", "--output", tmp_path / "csv") == 0
    assert [p.name for p in (tmp_path / "csv").iterdir()] == ["worm__power.csv"]
    assert "/worm/bad is left out" in capsys.readouterr().err


@pytest.mark.parametrize(
    "arguments",
    [
        ("{bag}", "--output", "{bag}"),
        ("no", "--output", "x"),
        ("{bag}", "--output", "x", "--topic", "/no"),
    ],
)
def test_bad_input_ends_with_status_2(bag: Path, tmp_path: Path, monkeypatch, capsys, arguments):
    monkeypatch.chdir(tmp_path)
    assert command(monkeypatch, *(a.format(bag=bag) for a in arguments)) == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert list(tmp_path.iterdir()) == []
