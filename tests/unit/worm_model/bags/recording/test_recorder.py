# SPDX-License-Identifier: Apache-2.0
"""The recorder's bags, read by the independent readers."""

import struct
from pathlib import Path

import yaml
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.interfaces import QosDurability, QosReliability

from worm_model.bags.formats.bag_metadata import dump_yaml, qos_profile
from worm_model.bags.formats.message_block import Topic
from worm_model.bags.recording.recorder import BagRecorder, Manifest

NOW = 1_800_000_000_000_000_000
FOREVER = 2**63 - 1
LATCHED = qos_profile(
    "keep_last", 1, "reliable", "transient_local", "automatic", (FOREVER, FOREVER, FOREVER)
)
# Hash as ROS 2 Jazzy has it for std_msgs/msg/UInt64.
UINT64_HASH = "RIHS01_fbdc52018fc13755dce18024d1a671c856aa8b4aaf63adfb095b608f98e8c943"


def topic(name: str, qos: str) -> Topic:
    metadata = (("offered_qos_profiles", qos), ("topic_type_hash", UINT64_HASH))
    return Topic(name, "std_msgs/msg/UInt64", 0, "uint64 data\n", "ros2msg", "cdr", metadata)


TOPIC = topic("/counter", dump_yaml([LATCHED]))
OTHER = topic("/other", "")


def payload(value: int) -> bytes:
    return b"\x00\x01\x00\x00" + struct.pack("<Q", value)


def record(directory: Path, count: int = 10) -> BagRecorder:
    recorder = BagRecorder(directory, Manifest())
    for i in range(count):
        recorder.write(TOPIC if i % 2 else OTHER, payload(i), NOW + i * 10**8, NOW + i * 10**8 - 5)
    return recorder


def values(directory: Path) -> list[int]:
    with AnyReader([directory]) as reader:
        return [reader.deserialize(d, c.msgtype).data for c, _, d in reader.messages()]


def metadata(directory: Path) -> dict:
    return yaml.safe_load((directory / "metadata.yaml").read_text())["rosbag2_bagfile_information"]


def test_independent_readers_read_back_what_was_recorded(tmp_path: Path):
    record(tmp_path / "bag").close()
    with AnyReader([tmp_path / "bag"]) as reader:  # checks the type hash, too
        assert reader.message_count == 10
        assert {c.topic: c.msgcount for c in reader.connections} == {"/counter": 5, "/other": 5}
        offered = {c.topic: c.ext.offered_qos_profiles for c in reader.connections}
    assert values(tmp_path / "bag") == list(range(10))
    assert offered["/other"] == []
    assert offered["/counter"][0].durability == QosDurability.TRANSIENT_LOCAL
    assert offered["/counter"][0].reliability == QosReliability.RELIABLE
    with (tmp_path / "bag" / "bag_0.mcap").open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        assert reader.get_header().profile == "ros2"
        decoded = list(reader.iter_decoded_messages())
    assert [d.decoded_message.data for d in decoded] == list(range(10))
    assert [d.message.publish_time - d.message.log_time for d in decoded] == [-5] * 10
    channel = next(d.channel for d in decoded if d.channel.topic == "/counter")
    assert channel.metadata["topic_type_hash"] == UINT64_HASH
    assert yaml.safe_load(channel.metadata["offered_qos_profiles"]) == [LATCHED]


def test_metadata_exists_from_the_start_and_shows_the_state(tmp_path: Path):
    recorder = record(tmp_path / "bag", count=0)
    assert metadata(tmp_path / "bag")["custom_data"] == {"state": "being recorded"}
    recorder.close()
    assert metadata(tmp_path / "bag")["custom_data"] == {"state": "closed"}
