# SPDX-License-Identifier: Apache-2.0
"""Bags that other programs merged, renamed or made: contradictions are reported, and no bag causes a traceback."""

import math
import shutil
import struct
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from recorded_run import simulated_run, write_bag

from worm_model.bags.formats.bag_errors import BagError
from worm_model.bags.formats.bag_writer import new_bag
from worm_model.bags.formats.message_block import Message, Topic
from worm_model.bags.opening import open_bag
from worm_model.bags.run_reader import read_run
from worm_model.bags.run_writer import write_run
from worm_model.commands import export
from worm_model.run import Run

RUN = simulated_run(cycles=1)
POWER = "/worm/power"
SECOND = 10**9
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


def of_power(**changes: str) -> Callable[[Message], Message]:
    """Return a function that changes the channel of power samples."""

    def change(message: Message) -> Message:
        if message.topic != POWER:
            return message
        fields = {**vars(message.channel), **changes}
        return message._replace(channel=Topic(**fields))

    return change


def later(message: Message, log_s: int, stamp_s: int) -> Message:
    data = bytearray(message.data)
    struct.pack_into("<i", data, 4, struct.unpack_from("<i", data, 4)[0] + stamp_s)
    return message._replace(log_time=message.log_time + log_s * 10**9, data=bytes(data))


def reports_of(path: Path) -> list[str]:
    reported: list[str] = []
    with open_bag(path, reported.append) as bag:
        read_run(bag)
    return reported


def test_nothing_is_reported_about_a_valid_bag(tmp_path: Path, recorded: list[Message]):
    assert reports_of(written(tmp_path / "a", recorded)) == []


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
    merged = written(tmp_path / "a", [*recorded, *(later(m, 1000, -1000) for m in recorded)])
    assert any(f"1 stamps of {POWER} go back" in line for line in reports_of(merged))
    in_order = written(tmp_path / "b", [*recorded, *(later(m, 1000, 1000) for m in recorded)])
    assert reports_of(in_order) == []


@pytest.mark.parametrize("value", [math.inf, -math.inf])
def test_infinite_samples_are_left_out_which_is_reported(tmp_path: Path, value: float):
    power = RUN.power.power.copy()
    power[7] = value
    path = write_bag(tmp_path / "bag", replace(RUN, power=replace(RUN.power, power=power)))
    reported: list[str] = []
    with open_bag(path, reported.append) as bag:
        found = read_run(bag).power
    np.testing.assert_array_equal(found.power, np.delete(RUN.power.power, 7))
    np.testing.assert_array_equal(found.stamp, np.delete(RUN.power.stamp, 7))
    (line,) = reported
    assert line.startswith(f"{path}: 1 messages of {POWER} ")
    assert "infinite" in line


def test_runs_that_overlap_are_rejected(tmp_path: Path):
    """Two recordings merged by time are rejected; one after the other they are two runs."""
    longer = simulated_run(cycles=2)
    with new_bag(tmp_path / "late") as writer:
        write_run(writer, longer, "/worm")
        write_run(writer, later_run(longer, 3_600 * SECOND), "/worm")
    with open_bag(tmp_path / "late") as bag:
        assert len(read_run(bag).gait_state.rows_of_runs()) == 2
    with new_bag(tmp_path / "mixed") as writer:
        write_run(writer, longer, "/worm")
        write_run(writer, later_run(longer, SECOND), "/worm")
    with (
        open_bag(tmp_path / "mixed", lambda _: None) as bag,
        pytest.raises(BagError, match="runs of gaits overlap"),
    ):
        read_run(bag)


def later_run(run: Run, by: int) -> Run:
    """Return the same messages, later by some ns."""
    states = run.gait_state
    moved = {
        name: replace(getattr(run, name), stamp=getattr(run, name).stamp + by)
        for name in ("commanded", "measured", "tracker", "power")
    }
    onset = np.where(states.onset > 0, states.onset + by, 0)
    return replace(run, gait_state=replace(states, stamp=states.stamp + by, onset=onset), **moved)


def test_a_file_that_metadata_does_not_name_is_reported(tmp_path: Path, whole: Path):
    bag = tmp_path / "bag"
    shutil.copytree(whole, bag)
    shutil.copy(next(whole.glob("*.mcap")), bag / "other.mcap")
    assert any("other.mcap not read" in line for line in reports_of(bag))


def test_a_definition_that_contains_itself_is_rejected(
    tmp_path: Path, recorded: list[Message], monkeypatch, capsys
):
    channel = Topic("/w", "x/msg/W", 0, "x/W data\n", "ros2msg", "cdr")
    message = recorded[0]._replace(channel=channel, data=b"\0\1\0\0" + bytes(8))
    bag = written(tmp_path / "a", [*recorded, message])
    monkeypatch.setattr("sys.argv", ["export", str(bag), "--output", str(tmp_path / "out")])
    assert export.main() == 1
    assert "/w is left out: /w: its definition contains itself" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["", "/", "/a\0b", "/a\nb", "/../../../x", "/" + 300 * "ä"])
def test_any_name_of_a_topic_becomes_that_of_a_file(
    tmp_path: Path, recorded: list[Message], name: str, monkeypatch
):
    channel = Topic(name, "std_msgs/msg/UInt8", 0, "uint8 data\n", "ros2msg", "cdr")
    message = recorded[0]._replace(channel=channel, data=b"\0\1\0\0\5")
    bag = written(tmp_path / "a", [*recorded, message])
    monkeypatch.setattr("sys.argv", ["export", str(bag), "--output", str(tmp_path / "out")])
    assert export.main() == 0
    assert {p.name for p in tmp_path.iterdir()} == {"a", "out"}
    tables = {p.name: p.read_text().splitlines() for p in (tmp_path / "out").iterdir()}
    tables.pop("run.csv")  # of the robot's topics
    assert len(tables) == 6
    assert all(file.isprintable() and not file.startswith(".csv") for file in tables)
    assert [f"{recorded[0].log_time},5"] in [lines[1:] for lines in tables.values()]
