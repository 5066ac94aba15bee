# SPDX-License-Identifier: Apache-2.0
"""Bags that other programs merged, renamed or made: contradictions are reported, and no bag causes a traceback."""

import json
import math
import shutil
import struct
import subprocess
import sys
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from recorded_run import joined, later, simulated_run, write_bag

from worm_model.bags.formats.bag_errors import BagError, DefinitionError
from worm_model.bags.formats.bag_writer import new_bag
from worm_model.bags.formats.message_block import Message, Topic
from worm_model.bags.formats.message_types import SEPARATOR, parse_types, topic_of
from worm_model.bags.opening import open_bag
from worm_model.bags.operations.copies import write_part
from worm_model.bags.run_reader import clock_offset, read_run
from worm_model.commands import bags, export

RUN = simulated_run(cycles=1)
POWER = "/worm/power"
SECOND = 10**9
HOUR = 3600 * SECOND
Change = Callable[[Message], Message | None]


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> Path:
    return write_bag(tmp_path_factory.mktemp("bags") / "bag", RUN)


@pytest.fixture(scope="module")
def recorded(whole: Path) -> list[Message]:
    with open_bag(whole) as bag:
        return list(bag.messages())


def written(path: Path, messages: Iterable[Message]) -> Path:
    with new_bag(path) as writer:
        writer.write_all(messages)
    return path


def reports_of(path: Path) -> list[str]:
    reported: list[str] = []
    with open_bag(path, reported.append) as bag:
        read_run(bag)
    return reported


def text_topic(name: str = "/chatter") -> Topic:
    return Topic(name, "std_msgs/msg/String", 0, "string data\n", "ros2msg", "cdr")


def text_message(time: int, topic: Topic, text: bytes = b"hello\0") -> Message:
    data = b"\0\1\0\0" + struct.pack("<I", len(text)) + text
    return Message(topic.name, time, data, time, topic)


IDL = """
module demo_msgs {
  module msg {
    typedef double double__3[3];
    module Arm_Constants {
      const boolean ON = TRUE;
      const float HALF = 5e-1;
      @verbatim (language="comment", text="a; b }" "\\n" "// c")
      const string NAME = "arm; }";
      const wstring WIDE = L"x";
    };
    struct Arm {
      @default (value=(1.0, 2.0, -3.0))
      double__3 speed;
      /* of each
         joint */
      @default (value="a, b (c)")
      string<20> label;
      @range (min=-1, max=demo_msgs::msg::Arm_Constants::ON)
      sequence<unsigned long, 4> codes;
    };
  };
};
"""
SAME = "float64[3] speed\nstring<=20 label\nuint32[<=4] codes\n"


def test_idl_with_texts_that_look_like_its_syntax_gives_the_fields_of_the_same_message():
    found = parse_types("demo_msgs/msg/Arm", f"{SEPARATOR}\nIDL: demo_msgs/msg/Arm{IDL}", "ros2idl")
    assert found == parse_types("demo_msgs/msg/Arm", SAME, "ros2msg")


def test_idl_that_is_none_is_rejected_in_one_line():
    with pytest.raises(DefinitionError) as error:
        parse_types("a/msg/B", "#include <x>\nmodule a { union", "ros2idl")
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("topics", "messages"),
    [
        ([], []),
        ([], [text_message(10**18, text_topic("/other/power"))]),
        ([topic_of(POWER, "worm_msgs/msg/Power")], []),
    ],
    ids=["no topic", "another robot", "a silent worm"],
)
def test_an_intact_bag_without_a_run_is_not_called_damaged(
    tmp_path, monkeypatch, run, topics, messages
):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    with new_bag(tmp_path / "bags" / "one") as writer:
        for topic in topics:
            writer.add_topic(topic)
        writer.write_all(messages)
    status, out, _ = run(bags, tmp_path / "bags", "--json")
    assert status == 0
    (row,) = json.loads(out)["runs"]
    assert (row["state"], row["gait"]) == ("no run", None)
    assert row["notes"]


@pytest.mark.parametrize("far", [0, 4_294_967_295 * 10**9, 2**64 - 1, None])
def test_durations_and_positions_leave_out_gaps_of_log_time(tmp_path: Path, far: int | None):
    """Log times of zero, of the year 2106, and hours before the rest."""
    begin = 1_700_000_000 * 10**9
    far = begin - 5 * HOUR if far is None else far
    topic = text_topic()
    times = [begin + i * 10**9 for i in range(11)]
    with new_bag(tmp_path / "bag") as writer:
        writer.write_all(text_message(time, topic) for time in [*times[:5], far, *times[5:]])
    reported: list[str] = []
    with open_bag(tmp_path / "bag", reported.append) as bag:
        assert bag.duration_s == pytest.approx(10.0)
        assert [m.log_time for m in bag.messages()] == sorted([far, *times])
        positions = [bag.position_at(m.log_time) for m in bag.messages()]
        assert positions == sorted(positions)
        assert positions[-1] == pytest.approx(10.0)
        first = bag.time_at(2.5)
        assert first == begin + 25 * 10**8
        assert bag.position_at(first) == pytest.approx(2.5)
        assert write_part(bag, tmp_path / "part", first, bag.time_at(4.5), bag.topics) == 2
    (line,) = reported
    assert "gap" in line


def test_one_strange_log_time_does_not_move_the_start_of_a_run(tmp_path: Path, recorded):
    strange = [m._replace(log_time=0) for m in recorded[:3]]
    with open_bag(written(tmp_path / "b", [*strange, *recorded[3:]]), lambda _: None) as bag:
        assert clock_offset(bag, "") == 0


@pytest.mark.parametrize("kind", ["std_msgs/msg/String", "worm_msgs/msg/Power"])
def test_what_can_be_read_of_a_topic_is_read_and_the_rest_is_named(
    tmp_path: Path, recorded: list[Message], run, kind: str
):
    """Three messages of the power topic are of another channel."""
    other = Topic(POWER, kind, 0, "string data\n", "ros2msg", "json")
    mixed = list(recorded)
    for k in (30, 20, 10):
        mixed.insert(k + 1, text_message(recorded[k].log_time, other))
    path = written(tmp_path / "bag", mixed)
    reported: list[str] = []
    with open_bag(path, reported.append) as bag:
        assert read_run(bag).power.power.tolist() == RUN.power.power.tolist()
    assert any("3 messages of /worm/power" in line and "json" in line for line in reported)
    status, _, error = run(export, path, "--output", tmp_path / "out")
    assert status == 1
    assert f"3 messages of {kind} in json" in error
    rows = (tmp_path / "out" / "worm__power.csv").read_text().splitlines()
    assert len(rows) == 1 + len(RUN.power.stamp)
    assert (tmp_path / "out" / "run.csv").exists()


def test_bags_are_read_without_fcntl(whole: Path):
    """Windows has no such module."""
    script = (
        "import sys; sys.modules['fcntl'] = None\n"
        "from pathlib import Path\n"
        "from worm_model.bags.opening import open_bag\n"
        "from worm_model.bags.run_reader import read_run\n"
        "from worm_model.commands import bags, export, replay\n"
        "with open_bag(Path(sys.argv[1])) as bag: print(len(read_run(bag).power.stamp))\n"
    )
    run = subprocess.run(
        [sys.executable, "-c", script, str(whole)], capture_output=True, text=True, check=False
    )
    assert (run.stdout, run.stderr) == (f"{len(RUN.power.stamp)}\n", "")


def of_power(**changes: str) -> Callable[[Message], Message]:
    """Return a function that changes the channel of power samples."""

    def change(message: Message) -> Message:
        if message.topic != POWER:
            return message
        fields = {**vars(message.channel), **changes}
        return message._replace(channel=Topic(**fields))

    return change


def message_later(message: Message, log_s: int, stamp_s: int) -> Message:
    data = bytearray(message.data)
    struct.pack_into("<i", data, 4, struct.unpack_from("<i", data, 4)[0] + stamp_s)
    return message._replace(log_time=message.log_time + log_s * 10**9, data=bytes(data))


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (
            of_power(type_name="foo_msgs/msg/Power"),
            f"{POWER} are not read: their type is foo_msgs/msg/",
        ),
        (
            of_power(type_name="", definition=""),
            f"{POWER} are not read: their type is message without a",
        ),
        (of_power(name="/power"), "topics under /, /worm/ "),
    ],
)
def test_unexpected_topics_are_reported(
    tmp_path: Path, recorded: list[Message], change: Change, expected: str
):
    assert any(
        expected in line for line in reports_of(written(tmp_path / "a", map(change, recorded)))
    )


def test_stamps_that_go_back_are_reported(tmp_path: Path, recorded: list[Message]):
    merged = written(
        tmp_path / "a", [*recorded, *(message_later(m, 1000, -1000) for m in recorded)]
    )
    assert any(f"1 stamps of {POWER} go back" in line for line in reports_of(merged))
    in_order = written(
        tmp_path / "b", [*recorded, *(message_later(m, 1000, 1000) for m in recorded)]
    )
    assert reports_of(in_order) == []


@pytest.mark.parametrize("value", [math.inf, -math.inf])
def test_infinite_samples_are_left_out_which_is_reported(tmp_path: Path, value: float):
    power = RUN.power.power.copy()
    power[7] = value
    path = write_bag(tmp_path / "bag", replace(RUN, power=replace(RUN.power, power=power)))
    with open_bag(path, lambda _: None) as bag:
        found = read_run(bag).power
    np.testing.assert_array_equal(found.power, np.delete(RUN.power.power, 7))
    np.testing.assert_array_equal(found.stamp, np.delete(RUN.power.stamp, 7))
    (line,) = reports_of(path)
    assert line.startswith(f"{path}: 1 messages of {POWER} ")
    assert "infinite" in line


def test_runs_that_overlap_are_rejected(tmp_path: Path):
    """Two recordings merged by time are rejected; one after the other they are two runs."""
    longer = simulated_run(cycles=2)
    late = write_bag(tmp_path / "late", joined([longer, later(longer, HOUR)]))
    with open_bag(late) as bag:
        assert len(read_run(bag).gait_state.rows_of_runs()) == 2
    mixed = write_bag(tmp_path / "mixed", joined([longer, later(longer, SECOND)]))
    with (
        open_bag(mixed, lambda _: None) as bag,
        pytest.raises(BagError, match="runs of gaits overlap"),
    ):
        read_run(bag)


def test_a_file_that_metadata_does_not_name_is_reported(tmp_path: Path, whole: Path):
    bag = tmp_path / "bag"
    shutil.copytree(whole, bag)
    shutil.copy(next(whole.glob("*.mcap")), bag / "other.mcap")
    assert any("other.mcap not read" in line for line in reports_of(bag))


def test_a_definition_that_contains_itself_is_rejected(
    tmp_path: Path, recorded: list[Message], run
):
    channel = Topic("/w", "x/msg/W", 0, "x/W data\n", "ros2msg", "cdr")
    message = recorded[0]._replace(channel=channel, data=b"\0\1\0\0" + bytes(8))
    bag = written(tmp_path / "a", [*recorded, message])
    status, _, error = run(export, bag, "--output", tmp_path / "out")
    assert status == 1
    assert "/w is left out: /w: its definition contains itself" in error


@pytest.mark.parametrize("name", ["", "/", "/a\0b", "/a\nb", "/../../../x", "/" + 300 * "ä"])
def test_any_name_of_a_topic_becomes_that_of_a_file(
    tmp_path: Path, recorded: list[Message], name: str, run
):
    channel = Topic(name, "std_msgs/msg/UInt8", 0, "uint8 data\n", "ros2msg", "cdr")
    message = recorded[0]._replace(channel=channel, data=b"\0\1\0\0\5")
    bag = written(tmp_path / "a", [*recorded, message])
    assert run(export, bag, "--output", tmp_path / "out")[0] == 0
    assert {p.name for p in tmp_path.iterdir()} == {"a", "out"}
    tables = {p.name: p.read_text().splitlines() for p in (tmp_path / "out").iterdir()}
    tables.pop("run.csv")  # of the robot's topics
    assert len(tables) == 6
    assert all(file.isprintable() and not file.startswith(".csv") for file in tables)
    assert [f"{recorded[0].log_time},5"] in [lines[1:] for lines in tables.values()]
