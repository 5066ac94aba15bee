# SPDX-License-Identifier: Apache-2.0
"""Content that other programs leave in bags: IDL, other types on a topic, log times far apart, no run of the worm."""

import json
import struct
import subprocess
import sys
from pathlib import Path

import pytest
from recorded_run import simulated_run, write_bag

from worm_model.bags.formats.bag_errors import DefinitionError
from worm_model.bags.formats.bag_writer import new_bag
from worm_model.bags.formats.message_block import Message, Topic
from worm_model.bags.formats.message_types import SEPARATOR, parse_types, topic_of
from worm_model.bags.opening import open_bag
from worm_model.bags.operations.copies import write_part
from worm_model.bags.run_reader import clock_offset, read_run
from worm_model.commands import bags, export

RUN = simulated_run(cycles=1)
HOUR = 3600 * 10**9


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


def write_no_topic(path: Path) -> None:
    with new_bag(path):
        pass


def write_other_robot(path: Path) -> None:
    with new_bag(path) as writer:
        writer.write_all([text_message(10**18, text_topic("/other/power"))])


def write_silent_worm(path: Path) -> None:
    with new_bag(path) as writer:
        writer.add_topic(topic_of("/worm/power", "worm_msgs/msg/Power"))


@pytest.mark.parametrize("write", [write_no_topic, write_other_robot, write_silent_worm])
def test_an_intact_bag_without_a_run_is_not_called_damaged(tmp_path, monkeypatch, capsys, write):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    (tmp_path / "bags").mkdir()
    write(tmp_path / "bags" / "one")
    monkeypatch.setattr("sys.argv", ["bags", str(tmp_path / "bags"), "--json"])
    assert bags.main() == 0
    (row,) = json.loads(capsys.readouterr().out)["runs"]
    assert row["state"] == "no run"
    assert row["gait"] is None
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


def test_one_strange_log_time_does_not_move_the_start_of_a_run(tmp_path: Path):
    with open_bag(write_bag(tmp_path / "a", RUN)) as bag:
        messages = list(bag.messages())
    with new_bag(tmp_path / "b") as writer:
        writer.write_all(m._replace(log_time=0) for m in messages[:3])
        writer.write_all(messages[3:])
    with open_bag(tmp_path / "b", lambda _: None) as bag:
        assert clock_offset(bag, "") == 0


def mixed(path: Path, other: Topic) -> Path:
    """Write a run whose power topic also has three messages of another channel."""
    with open_bag(write_bag(path.with_name("whole"), RUN)) as bag:
        messages = list(bag.messages())
    times = [m.log_time for m in messages]
    with new_bag(path) as writer:
        for k, message in enumerate(messages):
            writer.write_all([message])
            if k in (10, 20, 30):
                writer.write_all([text_message(times[k], other)])
    return path


@pytest.mark.parametrize("kind", ["std_msgs/msg/String", "worm_msgs/msg/Power"])
def test_what_can_be_read_of_a_topic_is_read_and_the_rest_is_named(
    tmp_path: Path, monkeypatch, capsys, kind: str
):
    other = Topic("/worm/power", kind, 0, "string data\n", "ros2msg", "json")
    path = mixed(tmp_path / "bag", other)
    reported: list[str] = []
    with open_bag(path, reported.append) as bag:
        assert read_run(bag).power.power.tolist() == RUN.power.power.tolist()
    assert any("3 messages of /worm/power" in line and "json" in line for line in reported)
    monkeypatch.setattr("sys.argv", ["export", str(path), "--output", str(tmp_path / "out")])
    assert export.main() == 1
    assert f"3 messages of {kind} in json" in capsys.readouterr().err
    rows = (tmp_path / "out" / "worm__power.csv").read_text().splitlines()
    assert len(rows) == 1 + len(RUN.power.stamp)
    assert (tmp_path / "out" / "run.csv").exists()


def test_bags_are_read_without_fcntl(tmp_path: Path):
    """Windows has no such module."""
    script = (
        "import sys; sys.modules['fcntl'] = None\n"
        "from pathlib import Path\n"
        "from worm_model.bags.opening import open_bag\n"
        "from worm_model.bags.run_reader import read_run\n"
        "from worm_model.commands import bags, export, replay\n"
        "with open_bag(Path(sys.argv[1])) as bag: print(len(read_run(bag).power.stamp))\n"
    )
    bag = write_bag(tmp_path / "bag", RUN)
    run = subprocess.run(
        [sys.executable, "-c", script, str(bag)], capture_output=True, text=True, check=False
    )
    assert (run.stdout, run.stderr) == (f"{len(RUN.power.stamp)}\n", "")
