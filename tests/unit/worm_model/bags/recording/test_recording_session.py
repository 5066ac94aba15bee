# SPDX-License-Identifier: Apache-2.0
"""Requests to a recorder while it runs."""

import time
from dataclasses import replace
from pathlib import Path

import pytest
import yaml

from worm_model.bags.formats.bag_errors import BagError, ExistsError
from worm_model.bags.formats.finding import dated
from worm_model.bags.formats.message_block import Message, Topic
from worm_model.bags.opening import open_bag
from worm_model.bags.recording.recorder import Manifest
from worm_model.bags.recording.recording_session import RING_BYTES, RecordingSession, after_crash

TOPIC = Topic("/a", "std_msgs/msg/UInt64", 0, "uint64 data\n", "ros2msg", "cdr")
QOS = ("offered_qos_profiles", "- durability: transient_local\n")
LATCHED = replace(TOPIC, name="/state", metadata=(QOS,))
SECOND = 10**9


def message(value: int, topic: Topic = TOPIC, size: int = 8) -> Message:
    data = b"\0\1\0\0" + value.to_bytes(8, "little") + bytes(size - 8)
    return Message(topic.name, value * SECOND, data, value * SECOND, topic)


def session(output: Path, ring_s: float = 0.0) -> RecordingSession:
    manifest = Manifest({"worm_run": {"seed": "4"}})
    return RecordingSession(output, lambda: manifest, ring_s)


def seconds(bag: Path) -> list[int]:
    with open_bag(bag) as opened:
        assert opened.metadata["worm_run"] == {"seed": "4"}
        return [m.log_time // SECOND for m in opened.messages()]


def state(bag: Path) -> str:
    content = yaml.safe_load((bag / "metadata.yaml").read_text())
    return content["rosbag2_bagfile_information"]["custom_data"]["state"]


def test_a_bag_holds_messages_and_topics_of_which_nothing_came(tmp_path: Path):
    """A topic without messages differs from a topic without a subscription."""
    recording = session(tmp_path / "bag")
    recording.add_topics([TOPIC, LATCHED])
    recording.offer([message(1), message(2)])
    recording.offer([])
    recording.add_topics([TOPIC, LATCHED])
    assert state(tmp_path / "bag") == "being recorded"  # metadata.yaml exists from the start
    recording.close()
    assert state(tmp_path / "bag") == "closed"
    assert (recording.messages, recording.bytes, recording.error) == (2, 24, None)
    assert seconds(tmp_path / "bag") == [1, 2]
    with open_bag(tmp_path / "bag") as bag:
        assert {name: topic.count for name, topic in bag.topics.items()} == {"/a": 2, "/state": 0}


def test_a_snapshot_holds_the_last_seconds_and_what_is_latched(tmp_path: Path):
    recording = session(tmp_path / "bag", ring_s=5.0)
    with pytest.raises(BagError, match="nothing has been received"):
        recording.snapshot()
    recording.offer([message(1, LATCHED), message(2, LATCHED)])
    for value in range(3, 20):
        recording.offer([message(value)])
    assert "bag_snapshot_1" in recording.snapshot()
    recording.offer([message(20)])
    recording.snapshot()
    recording.close()
    assert [bag.name for bag in recording.bags] == ["bag_snapshot_1", "bag_snapshot_2"]
    assert [seconds(bag) for bag in recording.bags] == [[2, *range(14, 20)], [2, 20]]
    assert not (tmp_path / "bag").exists()


def test_a_snapshot_that_cannot_be_written_keeps_its_messages(tmp_path: Path):
    recording = session(tmp_path / "bag", ring_s=5.0)
    recording.offer([message(1), message(2)])
    (tmp_path / "bag_snapshot_1").mkdir()
    with pytest.raises(BagError):
        recording.snapshot()
    recording.snapshot()
    recording.close()
    assert seconds(tmp_path / "bag_snapshot_2") == [1, 2]


def test_a_ring_does_not_outgrow_the_memory(tmp_path: Path):
    recording = session(tmp_path / "bag", ring_s=1000.0)
    size = RING_BYTES // 4
    for value in range(8):
        recording.offer([message(value, size=size)])
    recording.snapshot()
    recording.close()
    assert seconds(tmp_path / "bag_snapshot_1") == [5, 6, 7]


def test_after_a_crash_it_goes_on_in_the_next_bag_and_what_is_closed_is_not_touched(tmp_path: Path):
    output = tmp_path / "bag"
    assert after_crash(output) == output
    crashed = session(output)  # a bag that is still being written is not closed, either
    assert after_crash(output) == tmp_path / "bag_2"
    second = session(tmp_path / "bag_2")
    assert after_crash(output) == tmp_path / "bag_3"
    second.close()
    assert after_crash(output) == tmp_path / "bag_2"  # this bag is rejected, as it exists
    with pytest.raises(ExistsError, match="bag_2 exists already"):
        session(after_crash(output))
    (output / "metadata.yaml").unlink()
    assert after_crash(output) == tmp_path / "bag_2"
    crashed.close()
    assert after_crash(output) == output


def test_a_recording_is_named_by_the_time_of_its_begin(tmp_path: Path):
    before = time.strftime("run_%Y_%m_%d-%H_%M_%S")
    name = dated(tmp_path / "run_{time}").name
    assert before <= name <= time.strftime("run_%Y_%m_%d-%H_%M_%S")
    assert dated(tmp_path / "run_%Y") == tmp_path / "run_%Y"
