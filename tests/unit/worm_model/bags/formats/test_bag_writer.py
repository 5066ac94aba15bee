# SPDX-License-Identifier: Apache-2.0
"""Other readers read written messages and metadata back unchanged."""

import resource
from collections import Counter
from dataclasses import replace
from io import BytesIO
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from rosbags.interfaces import QosDurability, QosReliability
from rosbags.rosbag2 import Reader as RosbagsReader

from worm_model.bags.formats.bag_errors import ExistsError, UnwritableError
from worm_model.bags.formats.bag_metadata import FOREVER, dump_yaml, qos_profile
from worm_model.bags.formats.bag_writer import new_bag, new_folder
from worm_model.bags.formats.message_block import Message, Topic, concatenate, messages_of
from worm_model.bags.formats.stored_file import LONGEST_GAP_NS, AttachedFile
from worm_model.bags.opening import open_bag
from worm_model.bags.operations.copies import recover

TYPE = "std_msgs/msg/UInt64"
QOS = qos_profile("keep_last", 1, "reliable", "transient_local", "automatic", FOREVER)
METADATA = (("offered_qos_profiles", dump_yaml([QOS])), ("topic_type_hash", "RIHS01_" + "0" * 64))
NAMES = ("/a", "/b", "/c")
TOPICS = [Topic(n, TYPE, 0, "uint64 data\n", "ros2msg", "cdr", METADATA) for n in NAMES]
ATTACHED = AttachedFile("parameters.yaml", "application/yaml", b"pitch: 0.0173\n")
TIMES = st.integers(0, 5) | st.integers(0, 2**64 - 1)


def message(topic: Topic, log_time: int, data: bytes, publish_time: int) -> Message:
    return Message(topic.name, log_time, data, publish_time, topic)


MESSAGES = st.lists(
    st.builds(message, st.sampled_from(TOPICS), TIMES, st.binary(max_size=90), TIMES), max_size=40
)


OTHER = replace(TOPICS[0], definition="int64 data\n")


def write(path: Path, messages: list[Message]) -> Path:
    with new_bag(path) as writer:
        writer.add_attachment(ATTACHED)
        for topic in TOPICS:
            writer.add_topic(topic)
        assert writer.write_all(messages) == len(messages)
        writer.add_metadata("worm_run", {"seed": "4"})
    return path


def file_of(bag: Path) -> Path:
    return bag / f"{bag.name}_0.mcap"


def columns(messages: list[Message]) -> Counter:
    return Counter((m.topic, m.log_time, m.data, m.publish_time) for m in messages)


@settings(max_examples=50, deadline=None)
@given(MESSAGES)
def test_any_messages_are_read_back(messages: list[Message]):
    with TemporaryDirectory() as folder:
        bag = write(Path(folder, "bag"), messages)
        reader = make_reader(BytesIO(file_of(bag).read_bytes()), validate_crcs=True)
        by_library = Counter(
            (c.topic, m.log_time, m.data, m.publish_time) for _, c, m in reader.iter_messages()
        )
        assert by_library == columns(messages)
        with open_bag(bag, lambda _: None) as own:
            assert list(own.messages()) == sorted(messages, key=lambda m: m.log_time)
            counts = Counter(message.topic for message in messages)
            assert {n: t.count for n, t in own.topics.items()} == {n: counts[n] for n in NAMES}
            times = sorted(m.log_time for m in messages)
            steps = [b - a for a, b in pairwise(times)]
            assert own.start == min(times, default=0)
            assert own.duration_s == sum(step for step in steps if step <= LONGEST_GAP_NS) * 1e-9
            assert list(own.attachments()) == [ATTACHED]
            assert own.metadata["worm_run"] == {"seed": "4"}


@settings(max_examples=25, deadline=None)
@given(MESSAGES.map(lambda found: [m for m in found if m.log_time < 2**62]))
def test_rosbags_reads_them(messages: list[Message]):
    with (
        TemporaryDirectory() as folder,
        RosbagsReader(write(Path(folder, "bag"), messages)) as reader,
    ):
        found = [(c.topic, time, bytes(data)) for c, time, data in reader.messages()]
        assert reader.message_count == len(messages)
        for connection in reader.connections:
            (offered,) = connection.ext.offered_qos_profiles
            assert offered.durability == QosDurability.TRANSIENT_LOCAL
            assert offered.reliability == QosReliability.RELIABLE
    assert Counter(found) == Counter((m.topic, m.log_time, m.data) for m in messages)


def test_two_layouts_of_a_topic_stay_two(tmp_path: Path):
    """Also after a recovery: no message gets the definition of another."""
    messages = [message((TOPICS[0], OTHER)[i % 2], i, bytes(12), i) for i in range(10)]
    bag = write(tmp_path / "bag", messages)
    recover(bag, tmp_path / "saved")
    for path in (bag, tmp_path / "saved"):
        with open_bag(path) as own:
            assert [m.channel.definition for m in own.messages()] == [
                m.channel.definition for m in messages
            ]
            assert own.topics["/a"].count == 10


@given(MESSAGES, st.lists(st.sampled_from([*TOPICS, OTHER]), min_size=1))
def test_blocks_of_messages_hold_what_single_messages_hold(messages, channels):
    rows = [m._replace(channel=c, topic=c.name) for m, c in zip(messages, channels, strict=False)]
    rows = rows or [message(OTHER, 0, b"", 0)]
    block = messages_of(rows)
    assert list(block) == list(block.compact()) == rows
    assert list(block.sorted()) == sorted(rows, key=lambda m: m.log_time)
    assert list(concatenate([block, block.sorted()])) == [*block, *block.sorted()]
    assert {name: list(part) for name, part in block.by_topic()} == {
        name: [m for m in rows if m.topic == name] for name in {m.topic for m in rows}
    }


def test_a_disk_that_is_full_in_the_middle_is_reported_and_nothing_is_left(tmp_path: Path):
    """A limit of the process ends writing as on a full disk."""
    draw = np.random.default_rng(4)
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, before[1]))
    try:
        messages = [message(TOPICS[0], i, draw.bytes(1000), i) for i in range(100)]
        with pytest.raises(UnwritableError, match="bag cannot be written: File too large"):
            write(tmp_path / "bag", messages)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert list(tmp_path.iterdir()) == []


def test_metadata_of_a_bag_next_to_and_inside_its_file(tmp_path: Path):
    """Also with texts that YAML has to quote or to fold."""
    custom = {"state": "a: b # c", "lines": "one\n\n  two\n", "long": "word " * 60 + "é"}
    with new_bag(tmp_path / "bag") as writer:
        writer.custom = custom
        for topic in TOPICS:
            writer.add_topic(topic)
        writer.write(TOPICS[1], b"12", 7, 7)
        writer.write(TOPICS[1], b"12", 5, 7)
    bag_metadata = yaml.safe_load((tmp_path / "bag" / "metadata.yaml").read_text(encoding="utf-8"))
    content = bag_metadata["rosbag2_bagfile_information"]
    reader = make_reader(BytesIO(file_of(tmp_path / "bag").read_bytes()))
    copies = [yaml.safe_load(m.metadata["serialized_metadata"]) for m in reader.iter_metadata()]
    extent = {
        "duration": {"nanoseconds": 2},
        "starting_time": {"nanoseconds_since_epoch": 5},
        "message_count": 2,
    }
    assert content["custom_data"] == custom
    assert content["relative_file_paths"] == ["bag_0.mcap"]
    assert content["files"] == [{"path": "bag_0.mcap", **extent}]
    counts = {
        t["topic_metadata"]["name"]: t["message_count"]
        for t in content["topics_with_message_count"]
    }
    assert counts == {"/a": 0, "/b": 2, "/c": 0}
    assert copies[-1] == {**content, "relative_file_paths": [], "files": []}
    assert copies[0]["message_count"] == 0


def test_nothing_is_left_after_an_exception(tmp_path: Path):
    def interrupted() -> None:
        with new_folder(tmp_path / "bag") as folder:
            (folder / "file").write_text("content")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert list(tmp_path.iterdir()) == []


def test_what_was_made_meanwhile_is_not_overwritten(tmp_path: Path):
    def too_late() -> None:
        with new_folder(tmp_path / "bag") as folder:
            (folder / "file").write_text("late")
            (tmp_path / "bag").mkdir()
            (tmp_path / "bag" / "file").write_text("early")

    with pytest.raises(ExistsError, match="meanwhile"):
        too_late()
    assert (tmp_path / "bag" / "file").read_text() == "early"
