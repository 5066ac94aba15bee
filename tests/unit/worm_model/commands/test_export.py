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

from worm_model.bags.formats.bag_writer import new_bag
from worm_model.bags.formats.cdr import encode
from worm_model.bags.formats.message_block import Topic
from worm_model.bags.formats.message_types import topic_of, typestore
from worm_model.bags.run_writer import write_run
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


def test_the_merged_table_is_in_seconds_since_the_onset(bag: Path, tmp_path: Path, monkeypatch):
    assert command(monkeypatch, bag, "--output", tmp_path / "csv") == 0
    merged = table(tmp_path / "csv" / "run.csv")
    rows = [row for row, cell in enumerate(merged["power_W"]) if cell]
    power = [float(merged["power_W"][row]) for row in rows]
    np.testing.assert_array_equal(power, RUN.power.valid_power)
    time = [float(merged["time_s"][row]) for row in rows]
    onset = int(RUN.gait_state.onset.max())
    np.testing.assert_allclose(time, 1e-9 * (RUN.power.stamp - onset), atol=1e-9)
    assert set(merged["gait"]) == {"1"}


def test_several_robots_have_no_merged_table_until_one_is_named(
    tmp_path: Path, monkeypatch, capsys
):
    with new_bag(tmp_path / "bag") as writer:
        for namespace in ("/a", "/b"):
            write_run(writer, RUN, namespace)
    assert command(monkeypatch, tmp_path / "bag", "--output", tmp_path / "both") == 1
    assert "run is left out" in capsys.readouterr().err
    assert not (tmp_path / "both" / "run.csv").exists()
    arguments = (tmp_path / "bag", "--output", tmp_path / "one", "--namespace", "/b")
    assert command(monkeypatch, *arguments) == 0
    assert (tmp_path / "one" / "run.csv").exists()


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


def joints(store, sec: int, names: list[str]) -> bytes:
    """Return a message whose arrays have as many elements as there are names."""
    kind, empty = "sensor_msgs/msg/JointState", np.empty(0)
    time = store.types["builtin_interfaces/msg/Time"](sec, 999_999_999)
    header = store.types["std_msgs/msg/Header"](time, "")
    values = np.arange(float(len(names)))
    return bytes(store.serialize_cdr(store.types[kind](header, names, values, empty, empty), kind))


def test_sequences_become_a_column_an_element(tmp_path: Path, monkeypatch):
    """Also if they grow within the bag: missing elements are empty cells, and stamps do not overflow."""
    topic = topic_of("/worm/joint_states", "sensor_msgs/msg/JointState")
    store = typestore(topic.type_name, topic.definition, "ros2msg")
    sec = 1_800_000_000
    with new_bag(tmp_path / "bag") as writer:
        for i, names in enumerate((["a"], ["a", "b"], [], ["a"])):
            writer.write(topic, joints(store, sec + i, names), i, i)
    assert command(monkeypatch, tmp_path / "bag", "--output", tmp_path / "csv") == 0
    found = table(tmp_path / "csv" / "worm__joint_states.csv")
    assert found["position[0]"] == ["0.0", "0.0", "", "0.0"]
    assert found["position[1]"] == ["", "1.0", "", ""]
    assert found["name[0]"] == ["a", "a", "", "a"]
    assert found["name[1]"] == ["", "b", "", ""]
    assert found["log_time_ns"] == ["0", "1", "2", "3"]
    assert found["header.stamp_ns"] == [f"{sec + i}999999999" for i in range(4)]


def array_bag(path: Path, lengths: list[int]) -> Path:
    """Write stamped arrays of bytes, such as markers and images for a display."""
    topic = Topic("/a", "a/msg/B", 0, ARRAYS, "ros2msg", "cdr")
    store = typestore(topic.type_name, topic.definition, "ros2msg")
    t = store.types
    with new_bag(path) as writer:
        for i, length in enumerate(lengths):
            time = t["builtin_interfaces/msg/Time"](1_800_000_000 + i, 5)
            stamped = [t["a/msg/C"](time) for _ in range(length % 10)]
            message = t["a/msg/B"](np.full(length, i, np.uint8), stamped)
            writer.write(topic, bytes(store.serialize_cdr(message, "a/msg/B")), i, i)
    return path


ARRAYS = (
    "uint8[] data\nC[] marks\n"
    + f"{'=' * 80}\nMSG: a/C\nbuiltin_interfaces/Time stamp\n"
    + f"{'=' * 80}\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
)


def test_stamps_of_later_elements_that_some_messages_lack_are_right(tmp_path: Path, monkeypatch):
    bag = array_bag(tmp_path / "bag", [3, 8, 1, 8, 5])
    assert command(monkeypatch, bag, "--output", tmp_path / "csv") == 0
    found = table(tmp_path / "csv" / "a.csv")
    assert found["marks[6].stamp_ns"] == ["", "1800000001000000005", "", "1800000003000000005", ""]
    assert found["marks[2].stamp_ns"][4] == "1800000004000000005"
    parquet = pytest.importorskip("pyarrow.parquet")
    assert command(monkeypatch, bag, "--output", tmp_path / "x", "--format", "parquet") == 0
    column = parquet.read_table(tmp_path / "x" / "a.parquet")["marks[6].stamp_ns"]
    assert str(column.type) == "int64"
    assert column.to_pylist() == [None, 1800000001000000005, None, 1800000003000000005, None]


@pytest.mark.parametrize("kind", ["csv", "parquet"])
def test_large_arrays_are_left_out_by_name(tmp_path: Path, monkeypatch, capsys, kind: str):
    pytest.importorskip("pyarrow")
    bag = array_bag(tmp_path / "bag", [300_000, 2, 300_000])
    assert command(monkeypatch, bag, "--output", tmp_path / "out", "--format", kind) == 0
    assert "/a: data is not exported" in capsys.readouterr().err
    if kind == "csv":
        assert list(table(tmp_path / "out" / "a.csv"))[:2] == ["log_time_ns", "marks[0].stamp_ns"]


def test_topics_whose_names_would_be_the_same_file_are_two(tmp_path: Path, monkeypatch, capsys):
    topics = [Topic(n, "a/msg/B", 0, "int8 x\n", "ros2msg", "cdr") for n in ("/a/b", "/a__b")]
    with new_bag(tmp_path / "bag") as writer:
        for i, topic in enumerate(topics):
            writer.write(topic, b"\0\1\0\0" + bytes([i]), i, i)
    assert command(monkeypatch, tmp_path / "bag", "--output", tmp_path / "csv", "--json") == 0
    assert json.loads(capsys.readouterr().out)["rows"] == {"a__b.csv": 1, "a__b_2.csv": 1}
    assert table(tmp_path / "csv" / "a__b_2.csv")["x"] == ["1"]


def test_only_the_requested_topics(bag: Path, tmp_path: Path, monkeypatch):
    target = tmp_path / "csv"
    assert command(monkeypatch, bag, "--output", target, "--topic", "/worm/power") == 0
    assert [p.name for p in target.iterdir()] == ["worm__power.csv"]


def test_a_topic_that_cannot_be_decoded_is_left_out_and_reported_by_the_status(
    tmp_path: Path, monkeypatch, capsys
):
    power, bad = (topic_of(name, "worm_msgs/msg/Power") for name in ("/worm/power", "/worm/bad"))
    (data,) = encode(power, 1, {"power": 1.0}, {})
    with new_bag(tmp_path / "bag") as writer:
        writer.write(power, data, 1, 1)
        writer.write(bad, data[:-9], 2, 2)
    assert command(monkeypatch, tmp_path / "bag", "--output", tmp_path / "csv", "--json") == 1
    files = {p.name for p in (tmp_path / "csv").iterdir()}
    assert files == {"worm__power.csv", "run.csv"}
    reported = capsys.readouterr()
    assert "/worm/bad is left out" in reported.err
    assert "shorter" in json.loads(reported.out)["left_out"]["/worm/bad"]
