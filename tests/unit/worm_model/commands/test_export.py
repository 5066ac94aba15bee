# SPDX-License-Identifier: Apache-2.0
"""Tables of a bag."""

import csv
import json
import math
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


def table(path: Path) -> dict[str, list[str]]:
    with path.open(newline="") as stream:
        rows = list(csv.reader(stream))
    return {name: [row[i] for row in rows[1:]] for i, name in enumerate(rows[0])}


def test_csv_gives_the_numbers_back_exactly(bag: Path, tmp_path: Path, run):
    status, out, _ = run(export, bag, "--output", tmp_path / "csv", "--json")
    assert status == 0
    assert set(json.loads(out)["rows"]) == {p.name for p in (tmp_path / "csv").iterdir()}
    tracker = table(tmp_path / "csv" / "worm__tracker.csv")
    assert list(map(int, tracker["header.stamp_ns"])) == RUN.tracker.stamp.tolist()
    found = [float(cell) if cell else math.nan for cell in tracker["rear_position"]]
    np.testing.assert_array_equal(found, RUN.tracker.rear_position)
    states = table(tmp_path / "csv" / "worm__gait_state.csv")
    assert list(map(int, states["onset_ns"])) == RUN.gait_state.onset.tolist()
    assert set(states["message"]) == {""}
    power = [cell for cell in table(tmp_path / "csv" / "run.csv")["power_W"] if cell]
    np.testing.assert_array_equal(list(map(float, power)), RUN.power.valid_power)


def test_several_robots_have_no_merged_table_until_one_is_named(tmp_path: Path, run):
    with new_bag(tmp_path / "bag") as writer:
        for namespace in ("/a", "/b"):
            write_run(writer, RUN, namespace)
    status, _, error = run(export, tmp_path / "bag", "--output", tmp_path / "both")
    assert status == 1
    assert "run is left out" in error
    assert not (tmp_path / "both" / "run.csv").exists()
    arguments = ("--output", tmp_path / "one", "--namespace", "/b")
    assert run(export, tmp_path / "bag", *arguments)[0] == 0
    assert (tmp_path / "one" / "run.csv").exists()


def test_parquet_keeps_the_types(bag: Path, tmp_path: Path, run):
    parquet = pytest.importorskip("pyarrow.parquet")
    target = tmp_path / "tables"
    assert run(export, bag, "--output", target, "--format", "parquet")[0] == 0
    power = parquet.read_table(target / "worm__power.parquet")
    assert str(power.schema.field("power").type) == "double"
    assert str(power.schema.field("status").type) == "uint8"
    assert str(power.schema.field("header.stamp_ns").type) == "int64"
    assert power["power"].to_pylist() == RUN.power.power.tolist()
    assert power.num_rows == len(RUN.power.stamp)


ARRAYS = (
    "uint8[] data\nstring[] names\nC[] marks\n"
    + f"{'=' * 80}\nMSG: a/C\nbuiltin_interfaces/Time stamp\n"
    + f"{'=' * 80}\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
)


def array_bag(path: Path, lengths: list[int]) -> Path:
    """Write arrays of bytes, texts and stamps, such as markers and images for a display."""
    topic = Topic("/a", "a/msg/B", 0, ARRAYS, "ros2msg", "cdr")
    store = typestore(topic.type_name, topic.definition, "ros2msg")
    t = store.types
    with new_bag(path) as writer:
        for i, length in enumerate(lengths):
            time = t["builtin_interfaces/msg/Time"](1_800_000_000 + i, 5)
            stamped = [t["a/msg/C"](time) for _ in range(length % 10)]
            names = [f"n{k}" for k in range(length % 10)]
            message = t["a/msg/B"](np.full(length, i, np.uint8), names, stamped)
            writer.write(topic, bytes(store.serialize_cdr(message, "a/msg/B")), i, i)
    return path


def test_sequences_become_a_column_an_element(tmp_path: Path, run):
    """Also if they grow within the bag: missing elements are empty cells, and stamps do not overflow."""
    bag = array_bag(tmp_path / "bag", [3, 8, 0, 8, 5])
    assert run(export, bag, "--output", tmp_path / "csv")[0] == 0
    found = table(tmp_path / "csv" / "a.csv")
    assert found["log_time_ns"] == ["0", "1", "2", "3", "4"]
    assert found["data[0]"] == ["0", "1", "", "3", "4"]
    assert found["data[4]"] == ["", "1", "", "3", "4"]
    assert found["names[4]"] == ["", "n4", "", "n4", "n4"]
    assert found["marks[6].stamp_ns"] == ["", "1800000001000000005", "", "1800000003000000005", ""]
    assert found["marks[2].stamp_ns"][4] == "1800000004000000005"
    parquet = pytest.importorskip("pyarrow.parquet")
    assert run(export, bag, "--output", tmp_path / "x", "--format", "parquet")[0] == 0
    column = parquet.read_table(tmp_path / "x" / "a.parquet")["marks[6].stamp_ns"]
    assert str(column.type) == "int64"
    assert column.to_pylist() == [None, 1800000001000000005, None, 1800000003000000005, None]


@pytest.mark.parametrize("kind", ["csv", "parquet"])
def test_large_arrays_are_left_out_by_name(tmp_path: Path, run, kind: str):
    pytest.importorskip("pyarrow")
    bag = array_bag(tmp_path / "bag", [300_000, 2, 300_000])
    status, _, error = run(export, bag, "--output", tmp_path / "out", "--format", kind)
    assert status == 0
    assert "/a: data is not exported" in error
    if kind == "csv":
        assert list(table(tmp_path / "out" / "a.csv"))[:2] == ["log_time_ns", "marks[0].stamp_ns"]


def test_topics_whose_names_would_be_the_same_file_are_two(tmp_path: Path, run):
    topics = [Topic(n, "a/msg/B", 0, "int8 x\n", "ros2msg", "cdr") for n in ("/a/b", "/a__b")]
    with new_bag(tmp_path / "bag") as writer:
        for i, topic in enumerate(topics):
            writer.write(topic, b"\0\1\0\0" + bytes([i]), i, i)
    status, out, _ = run(export, tmp_path / "bag", "--output", tmp_path / "csv", "--json")
    assert status == 0
    assert json.loads(out)["rows"] == {"a__b.csv": 1, "a__b_2.csv": 1}
    assert table(tmp_path / "csv" / "a__b_2.csv")["x"] == ["1"]


def test_only_the_requested_topics(bag: Path, tmp_path: Path, run):
    target = tmp_path / "csv"
    assert run(export, bag, "--output", target, "--topic", "/worm/power")[0] == 0
    assert [p.name for p in target.iterdir()] == ["worm__power.csv"]


def test_a_topic_that_cannot_be_decoded_is_left_out_and_reported_by_the_status(tmp_path: Path, run):
    power, bad = (topic_of(name, "worm_msgs/msg/Power") for name in ("/worm/power", "/worm/bad"))
    (data,) = encode(power, 1, {"power": 1.0}, {})
    with new_bag(tmp_path / "bag") as writer:
        writer.write(power, data, 1, 1)
        writer.write(bad, data[:-9], 2, 2)
    status, out, error = run(export, tmp_path / "bag", "--output", tmp_path / "csv", "--json")
    assert status == 1
    files = {p.name for p in (tmp_path / "csv").iterdir()}
    assert files == {"worm__power.csv", "run.csv"}
    assert "/worm/bad is left out" in error
    assert "shorter" in json.loads(out)["left_out"]["/worm/bad"]
