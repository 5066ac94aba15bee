# SPDX-License-Identifier: Apache-2.0
"""Malformed bags: whatever is done to the bytes, a bag is read, recovered, or refused in one line."""

import struct
from functools import cache
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.writer import CompressionType, Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as RosbagsWriter
from rosbags.typesys import Stores, get_typestore

from worm_model.bags.bag_errors import BagError
from worm_model.bags.opening import open_bag
from worm_model.bags.run_reader import decode_topic


@cache
def mcap_bytes(compression: CompressionType, chunked: bool) -> bytes:
    stream = BytesIO()
    writer = Writer(stream, chunk_size=300, compression=compression, use_chunking=chunked)
    writer.start("ros2")
    schema = writer.register_schema("std_msgs/msg/UInt64", "ros2msg", b"uint64 data\n")
    channel = writer.register_channel("/a", "cdr", schema, {"topic_type_hash": ""})
    writer.add_metadata("worm_run", {"seed": "4"})
    writer.add_attachment(0, 0, "parameters.yaml", "application/yaml", b"pitch: 0.0173\n")
    for i in range(60):
        writer.add_message(channel, i + 1, b"\0\1\0\0" + struct.pack("<Q", i), i)
    writer.finish()
    return stream.getvalue()


@cache
def sqlite_bytes() -> bytes:
    with TemporaryDirectory() as folder:
        path = Path(folder, "bag")
        with RosbagsWriter(path, version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
            store = get_typestore(Stores.ROS2_JAZZY)
            connection = writer.add_connection("/a", "std_msgs/msg/UInt64", typestore=store)
            for i in range(60):
                writer.write(connection, i + 1, b"\0\1\0\0" + struct.pack("<Q", i))
        return next(path.glob("*.db3")).read_bytes()


EDITS = st.lists(
    st.tuples(
        st.floats(0, 1), st.sampled_from(["flip", "cut", "insert", "lengthen"]), st.integers(0, 255)
    ),
    min_size=1,
    max_size=4,
)


def edit(data: bytes, edits) -> bytes:
    edited = bytearray(data)
    for where, what, value in edits:
        at = min(int(where * len(edited)), len(edited) - 1) if edited else 0
        if what == "flip" and edited:
            edited[at] ^= value or 1
        elif what == "cut":
            del edited[at:]
        elif what == "insert":
            edited[at:at] = bytes([value]) * (value % 7 + 1)
        elif what == "lengthen" and edited:
            edited[at : at + 8] = struct.pack("<Q", 2 ** (value % 64))
    return bytes(edited)


def read(path: Path) -> None:
    with open_bag(path, lambda _: None) as bag:
        for topic in list(bag.topics.values()):
            count = sum(1 for _ in bag.messages([topic.name]))
            assert sum(len(block) for block in bag.blocks([topic.name])) == count
            decode_topic(topic, bag.payloads([topic.name])[topic.name])
        list(bag.attachments())


def read_or_refuse(data: bytes, name: str) -> None:
    refusal = "nothing is wrong"
    with TemporaryDirectory() as folder:
        path = Path(folder, name)
        path.write_bytes(data)
        try:
            read(path)
        except BagError as error:
            refusal = str(error)
        assert path.read_bytes() == data
    assert refusal
    assert "\n" not in refusal


@pytest.mark.parametrize("chunked", [True, False])
@pytest.mark.parametrize("compression", list(CompressionType))
@settings(max_examples=60, deadline=None)
@given(edits=EDITS)
def test_damaged_mcap(compression: CompressionType, chunked: bool, edits):
    read_or_refuse(edit(mcap_bytes(compression, chunked), edits), "a.mcap")


@settings(max_examples=60, deadline=None)
@given(edits=EDITS)
def test_damaged_sqlite3(edits):
    read_or_refuse(edit(sqlite_bytes(), edits), "a.db3")


@settings(max_examples=60, deadline=None)
@given(st.binary(max_size=200))
def test_random_bytes_behind_the_magic(data: bytes):
    read_or_refuse(b"\x89MCAP0\r\n" + data, "a.mcap")


@settings(max_examples=80, deadline=None)
@given(where=st.floats(0, 1))
def test_every_cut_keeps_what_is_whole(where: float):
    """Messages outside of chunks: exactly those before the cut come back."""
    data = mcap_bytes(CompressionType.NONE, False)
    last = data.rindex(b"\0\1\0\0" + struct.pack("<Q", 59))
    record = 31 + 12  # bytes of a message's record: its head and its payload
    first = last - 59 * record
    cut = int(first + where * (last - first))
    whole = (cut - first + 31) // record
    with TemporaryDirectory() as folder:
        path = Path(folder, "a.mcap")
        path.write_bytes(data[:cut])
        with open_bag(path, lambda _: None) as bag:
            assert [m.log_time for m in bag.messages()] == [i + 1 for i in range(whole)]
