# SPDX-License-Identifier: Apache-2.0
"""What is written from columns is read back equal by other readers, and the file's indexes agree with it."""

import errno
import resource
import struct
import zlib
from collections import Counter
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
import yaml
import zstandard
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.reader import NonSeekingReader, make_reader
from mcap.records import Channel, Footer, MessageIndex, Schema, SummaryOffset
from mcap.stream_reader import StreamReader
from rosbags.rosbag2 import Reader as RosbagsReader

from worm_model.bags import mcap_writer
from worm_model.bags.bag import AttachedFile, Message, Topic
from worm_model.bags.bag_errors import UnwritableError
from worm_model.bags.bag_writer import BagWriter
from worm_model.bags.blocks import block_of
from worm_model.bags.opening import open_bag
from worm_model.bags.payloads import payloads_of
from worm_model.bags.recovery import recover

TYPE = "std_msgs/msg/UInt64"
NAMES = ("/a", "/b", "/c")
ATTACHED = AttachedFile("parameters.yaml", "application/yaml", b"pitch: 0.0173\n")
TIMES = st.integers(0, 5) | st.integers(0, 2**64 - 1)
MESSAGES = st.lists(
    st.builds(Message, st.sampled_from(NAMES), TIMES, st.binary(max_size=90), TIMES), max_size=40
)


@pytest.fixture(autouse=True)
def small_chunks(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(mcap_writer, "CHUNK_BYTES", 300)


def topics() -> list[Topic]:
    metadata = (("offered_qos_profiles", ""), ("topic_type_hash", "RIHS01_" + "0" * 64))
    return [Topic(n, TYPE, 0, "uint64 data\n", "ros2msg", "cdr", metadata) for n in NAMES]


def write(path: Path, messages: list[Message], cuts: list[int]) -> Path:
    """One by one up to the first cut, then a block (which is in order of time) from cut to cut."""
    with BagWriter(path) as writer:
        writer.add_attachment(ATTACHED)
        for topic in topics():
            writer.add_topic(topic)
        for message in messages[: cuts[0]]:
            writer.write(message.topic, message.data, message.log_time, message.publish_time)
        for first, last in zip(cuts, [*cuts[1:], len(messages)], strict=True):
            part = messages[first:last]
            writer.write_block(
                block_of(
                    NAMES,
                    [NAMES.index(message.topic) for message in part],
                    payloads_of([m.data for m in part], [m.log_time for m in part]),
                    [message.publish_time for message in part],
                )
            )
        writer.add_metadata("worm_run", {"seed": "4"})
    return path


def by_time(messages: list[Message]) -> list[Message]:
    return sorted(messages, key=lambda message: message.log_time)


def file_of(bag: Path) -> Path:
    return bag / f"{bag.name}_0.mcap"


def library_messages(data: bytes) -> list[Message]:
    reader = make_reader(BytesIO(data), validate_crcs=True)
    return [
        Message(channel.topic, m.log_time, m.data, m.publish_time)
        for _, channel, m in reader.iter_messages()
    ]


@settings(max_examples=150, deadline=None)
@given(MESSAGES, st.data())
def test_any_messages_are_read_back_by_all_readers(messages: list[Message], data):
    cuts = sorted(data.draw(st.lists(st.integers(0, len(messages)), min_size=1, max_size=3)))
    with TemporaryDirectory() as folder:
        bag = write(Path(folder, "bag"), messages, cuts)
        written = file_of(bag).read_bytes()
        expected = Counter(messages)
        by_library = library_messages(written)
        assert Counter(by_library) == expected
        assert [m.log_time for m in by_library] == [m.log_time for m in by_time(messages)]
        stream = NonSeekingReader(BytesIO(written), validate_crcs=True)
        in_passing = [(c.topic, m.log_time, m.data) for _, c, m in stream.iter_messages()]
        assert Counter(in_passing) == Counter((m.topic, m.log_time, m.data) for m in messages)
        with open_bag(bag) as own:
            assert Counter(own.messages()) == expected
            assert [m.log_time for m in own.messages()] == [m.log_time for m in by_library]
            counts = Counter(message.topic for message in messages)
            assert {name: t.count for name, t in own.topics.items()} == {
                n: counts[n] for n in NAMES
            }
            assert (own.start, own.end) == (
                min((m.log_time for m in messages), default=0),
                max((m.log_time for m in messages), default=0),
            )
            assert list(own.attachments()) == [ATTACHED]
            assert own.metadata["worm_run"] == {"seed": "4"}


@settings(max_examples=60, deadline=None)
@given(MESSAGES.map(lambda found: [m for m in found if m.log_time < 2**62]))
def test_rosbags_reads_them(messages: list[Message]):
    with (
        TemporaryDirectory() as folder,
        RosbagsReader(write(Path(folder, "bag"), messages, [0])) as reader,
    ):
        found = [(c.topic, time, bytes(data)) for c, time, data in reader.messages()]
        assert reader.message_count == len(messages)
        assert {c.topic: c.msgcount for c in reader.connections} == {
            name: sum(message.topic == name for message in messages) for name in NAMES
        }
    assert Counter(found) == Counter((m.topic, m.log_time, m.data) for m in messages)


@settings(max_examples=80, deadline=None)
@given(MESSAGES, st.data())
def test_how_messages_are_divided_among_calls_leaves_no_trace(messages: list[Message], data):
    messages = by_time(messages)
    cuts = sorted(data.draw(st.lists(st.integers(0, len(messages)), min_size=1, max_size=4)))
    with TemporaryDirectory() as folder:
        one = write(Path(folder, "one"), messages, [len(messages)])
        other = write(Path(folder, "other"), messages, cuts)
        assert file_of(one).read_bytes() == file_of(other).read_bytes()


@settings(max_examples=60, deadline=None)
@given(MESSAGES)
def test_indexes_and_offsets_point_to_what_they_name(messages: list[Message]):
    with TemporaryDirectory() as folder:
        data = file_of(write(Path(folder, "bag"), messages, [0])).read_bytes()
    summary = make_reader(BytesIO(data)).get_summary()
    assert summary is not None
    found = Counter()
    for index in summary.chunk_indexes:
        assert data[index.chunk_start_offset] == Opcode.CHUNK
        start = index.chunk_start_offset + index.chunk_length
        assert min(index.message_index_offsets.values()) == start
        size = index.compressed_size
        records = zstandard.decompress(data[start - size : start])
        assert len(records) == index.uncompressed_size
        for channel, place in index.message_index_offsets.items():
            assert data[place] == Opcode.MESSAGE_INDEX
            entries = MessageIndex.read(ReadDataStream(BytesIO(data[place + 9 :])))
            assert entries.channel_id == channel
            for log_time, offset in entries.records:
                opcode, _, owner, _, time = struct.unpack_from("<BQHIQ", records, offset)
                assert (opcode, owner, time) == (Opcode.MESSAGE, channel, log_time)
                assert index.message_start_time <= time <= index.message_end_time
                found[channel] += 1
        assert place + 9 + 6 + 16 * len(entries.records) == start + index.message_index_length
    assert found == Counter(summary.statistics.channel_message_counts)
    assert summary.statistics.chunk_count == len(summary.chunk_indexes)
    assert (summary.statistics.attachment_count, summary.statistics.metadata_count) == (1, 3)
    check_summary(data)
    (attached,) = make_reader(BytesIO(data)).iter_attachments()
    assert (attached.name, attached.data) == (ATTACHED.name, ATTACHED.data)


def check_summary(data: bytes) -> None:
    """Its groups lie where its offsets say, without gaps, and the checksum covers what it should."""
    records = list(StreamReader(BytesIO(data), emit_chunks=True, validate_crcs=True).records)
    footer = records[-1]
    assert isinstance(footer, Footer)
    place = footer.summary_start
    for group in [record for record in records if isinstance(record, SummaryOffset)]:
        assert (group.group_start, data[place]) == (place, group.group_opcode)
        place += group.group_length
    assert place == footer.summary_offset_start
    assert footer.summary_crc == zlib.crc32(data[footer.summary_start : -8 - 4])


def test_a_message_larger_than_a_chunk(tmp_path: Path):
    messages = [
        Message("/a", time, bytes([time]) * size, time)
        for time, size in enumerate([10, 5000, 10, 3000, 0])
    ]
    written = file_of(write(tmp_path / "bag", messages, [0])).read_bytes()
    assert library_messages(written) == messages
    assert make_reader(BytesIO(written)).get_summary().statistics.chunk_count == 4


def test_a_bag_without_messages_keeps_its_topics_even_without_its_summary(tmp_path: Path):
    bag = write(tmp_path / "bag", [], [0])
    data = file_of(bag).read_bytes()
    assert library_messages(data) == []
    kinds = Counter(type(r) for r in StreamReader(BytesIO(data), validate_crcs=True).records)
    assert (kinds[Channel], kinds[Schema]) == (
        2 * len(NAMES),
        2,
    )  # among the data, and in the summary
    (tmp_path / "cut.mcap").write_bytes(data[:-30])
    recover(tmp_path / "cut.mcap", tmp_path / "saved")
    with open_bag(tmp_path / "saved") as saved:
        assert tuple(saved.topics) == NAMES
        assert list(saved.messages()) == []


def test_an_entirely_empty_bag(tmp_path: Path):
    with BagWriter(tmp_path / "bag"):
        pass
    with open_bag(tmp_path / "bag") as bag:
        assert (list(bag.messages()), bag.topics, bag.start, bag.end) == ([], {}, 0, 0)


def test_an_unknown_topic_is_refused_before_anything_is_written(tmp_path: Path):
    with pytest.raises(KeyError), BagWriter(tmp_path / "bag") as writer:
        writer.write("/a", b"", 0, 0)
    with pytest.raises(KeyError), BagWriter(tmp_path / "bag") as writer:
        writer.write_block(block_of(["/a"], [0], payloads_of([b""], [0]), [0]))
    assert list(tmp_path.iterdir()) == []


def test_a_disk_that_is_full_in_the_middle_is_said_and_nothing_is_left(tmp_path: Path):
    """By a limit of the process, at which writing fails as on a full disk."""
    draw = np.random.default_rng(4)
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, before[1]))
    try:
        messages = [Message("/a", i, draw.bytes(1000), i) for i in range(100)]
        with pytest.raises(UnwritableError, match="bag cannot be written: File too large"):
            write(tmp_path / "bag", messages, [0])
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert list(tmp_path.iterdir()) == []


def test_a_disk_that_takes_no_file_at_all_is_said_and_nothing_is_left(tmp_path: Path, monkeypatch):
    def refuse(path: Path, mode: str):
        raise OSError(errno.ENOSPC, "No space left on device", path)

    monkeypatch.setattr(Path, "open", refuse)
    with pytest.raises(UnwritableError, match="bag cannot be written: No space left on device"):
        BagWriter(tmp_path / "bag")
    assert list(tmp_path.iterdir()) == []


def test_a_summary_that_is_not_what_was_written_is_not_believed(tmp_path: Path):
    """With any of its bits flipped, all messages come, in their order."""
    messages = [Message(NAMES[i % 3], i, bytes(40), i) for i in range(60)]
    file = write(tmp_path / "bag", messages, [60]) / "bag_0.mcap"
    data = bytearray(file.read_bytes())
    summary = data.rindex(Opcode.DATA_END.to_bytes(1, "little") + struct.pack("<Q", 4)) + 13
    for place in np.random.default_rng(1).integers(summary, len(data) - 37, 40):
        data[place] ^= 0x40
        file.write_bytes(data)
        with open_bag(file) as bag:
            assert list(bag.messages()) == messages
        data[place] ^= 0x40


def test_many_sizes_of_messages(tmp_path: Path):
    draw = np.random.default_rng(3)
    messages = [
        Message(NAMES[i % 3], i // 2, draw.bytes(int(draw.integers(0, 400))), i)
        for i in range(2_500)
    ]
    bag = write(tmp_path / "bag", messages, [1100, 1200])
    with open_bag(bag) as own:
        assert list(own.messages()) == messages


def test_metadata_of_a_bag_beside_and_inside_its_file(tmp_path: Path):
    """Also with texts that YAML has to quote or to fold."""
    odd = {"state": "a: b # c", "lines": "one\n\n  two\n", "long": "word " * 60 + "é"}
    with BagWriter(tmp_path / "bag", odd) as writer:
        for topic in topics():
            writer.add_topic(topic)
        writer.write("/b", b"12", 7, 7)
        writer.write("/b", b"12", 5, 7)
    beside = yaml.safe_load((tmp_path / "bag" / "metadata.yaml").read_text(encoding="utf-8"))
    content = beside["rosbag2_bagfile_information"]
    reader = make_reader(BytesIO(file_of(tmp_path / "bag").read_bytes()))
    copies = [yaml.safe_load(m.metadata["serialized_metadata"]) for m in reader.iter_metadata()]
    extent = {
        "duration": {"nanoseconds": 2},
        "starting_time": {"nanoseconds_since_epoch": 5},
        "message_count": 2,
    }
    assert content["custom_data"] == odd
    assert content["relative_file_paths"] == ["bag_0.mcap"]
    assert content["files"] == [{"path": "bag_0.mcap", **extent}]
    counts = {
        t["topic_metadata"]["name"]: t["message_count"]
        for t in content["topics_with_message_count"]
    }
    assert counts == {"/a": 0, "/b": 2, "/c": 0}
    assert copies[-1] == {**content, "relative_file_paths": [], "files": []}
    assert copies[0]["message_count"] == 0
