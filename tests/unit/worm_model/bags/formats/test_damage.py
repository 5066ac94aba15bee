# SPDX-License-Identifier: Apache-2.0
"""Damaged bags: the messages read are right, or the bag is rejected, or the damage is reported.

An independent reader of the `mcap` library returns the content of the bag before the damage.
"""

import random
import struct
from collections import Counter
from functools import cache
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as RosbagsWriter
from rosbags.typesys import Stores, get_typestore

from worm_model.bags.formats.bag_errors import BagError
from worm_model.bags.formats.bag_metadata import qos_profiles
from worm_model.bags.formats.bag_writer import BagFiles, WriteOptions, new_bag
from worm_model.bags.formats.cdr import ColumnBuilder
from worm_model.bags.formats.contents import AttachedFile
from worm_model.bags.formats.message_block import Topic
from worm_model.bags.formats.message_types import topic_of
from worm_model.bags.opening import open_bag
from worm_model.bags.recovery.recovery import recover


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
            builder = ColumnBuilder()
            for block in bag.blocks([topic.name]):
                builder.add(block)
            assert builder.count == topic.count
        list(bag.attachments())


def read_or_reject(data: bytes, name: str) -> None:
    rejection = "nothing is wrong"
    with TemporaryDirectory() as folder:
        path = Path(folder, name)
        path.write_bytes(data)
        try:
            read(path)
        except BagError as error:
            rejection = str(error)
        assert path.read_bytes() == data
    assert rejection
    assert "\n" not in rejection


@pytest.mark.parametrize("chunked", [True, False])
@pytest.mark.parametrize("compression", list(CompressionType))
@settings(max_examples=60, deadline=None)
@given(edits=EDITS)
def test_damaged_mcap(compression: CompressionType, chunked: bool, edits):
    read_or_reject(edit(mcap_bytes(compression, chunked), edits), "a.mcap")


@settings(max_examples=60, deadline=None)
@given(edits=EDITS)
@example(edits=[(0.98828125, "flip", 128)])  # a time before 1970
@example(edits=[(0.625, "cut", 0), (0.1875, "flip", 128)])  # a column's name that is not UTF-8
def test_damaged_sqlite3(edits):
    read_or_reject(edit(sqlite_bytes(), edits), "a.db3")


@settings(max_examples=60, deadline=None)
@given(st.binary(max_size=200))
def test_random_bytes_behind_the_magic(data: bytes):
    read_or_reject(b"\x89MCAP0\r\n" + data, "a.mcap")


@settings(max_examples=80, deadline=None)
@given(where=st.floats(0, 1))
def test_every_cut_keeps_what_is_whole(where: float):
    """Outside of chunks, exactly the messages before the cut are returned."""
    data = mcap_bytes(CompressionType.NONE, False)
    last = data.rindex(b"\0\1\0\0" + struct.pack("<Q", 59))
    record = 31 + 12  # bytes of a message's record: head and payload
    first = last - 59 * record
    cut = int(first + where * (last - first))
    whole = (cut - first + 31) // record
    with TemporaryDirectory() as folder:
        path = Path(folder, "a.mcap")
        path.write_bytes(data[:cut])
        with open_bag(path, lambda _: None) as bag:
            assert [m.log_time for m in bag.messages()] == [i + 1 for i in range(whole)]


# --- right, rejected, or reported -----------------------------------------------------------------

Row = tuple[str, int, bytes, int]
NAMES = ("/worm/a", "/worm/b", "/c")
COUNT = 400


def make_bag(folder: Path, compression: str) -> Path:
    """Write a bag with many small chunks of three topics."""
    folder.mkdir()
    files = BagFiles(folder, "bag", WriteOptions(compression, chunk_bytes=600))
    files.add_metadata("worm_run", {"seed": "4"})
    files.add_attachment(AttachedFile("p.yaml", "application/yaml", b"pitch: 0.0173\n" * 9))
    draw = random.Random(5)
    topics = [Topic(n, "std_msgs/msg/UInt64", 0, "uint64 data\n", "ros2msg", "cdr") for n in NAMES]
    for i in range(COUNT):
        data = b"\0\1\0\0" + draw.randbytes(8)
        files.write(topics[i % 3], data, 1_000 + i, i)
    files.finish()
    return folder


def independent(data: bytes) -> Counter[Row]:
    reader = make_reader(BytesIO(data), validate_crcs=True)
    return Counter(
        (c.topic, m.log_time, m.data, m.publish_time) for _, c, m in reader.iter_messages()
    )


def top_level(data: bytes) -> list[tuple[int, int, int]]:
    """Return opcode, first and last byte of every record of the file."""
    found, place = [], 8
    while place < len(data) - 8:
        opcode, length = struct.unpack_from("<BQ", data, place)
        found.append((opcode, place, place + 9 + length))
        place += 9 + length
    return found


def flip_bit(data: bytearray, draw: random.Random) -> None:
    data[draw.randrange(8, len(data))] ^= 1 << draw.randrange(8)


def flip_in_head(data: bytearray, draw: random.Random) -> None:
    """Flip a bit in the opcode or the length of a record: the reader has to find the next record again."""
    _, first, _ = draw.choice(top_level(data))
    data[first + draw.randrange(9)] ^= 1 << draw.randrange(8)


def spoil_page(data: bytearray, draw: random.Random) -> None:
    first = draw.randrange(8, len(data))
    last = min(first + 512, len(data))
    data[first:last] = draw.choice([bytes(last - first), draw.randbytes(last - first)])


def drop_record(data: bytearray, draw: random.Random) -> None:
    _, first, last = draw.choice([r for r in top_level(data) if r[0] in (6, 7)])
    del data[first:last]


def double_record(data: bytearray, draw: random.Random) -> None:
    _, first, last = draw.choice([r for r in top_level(data) if r[0] in (6, 7)])
    data[last:last] = data[first:last]


def drop_chunk(data: bytearray, draw: random.Random) -> None:
    """Delete a chunk with the indexes behind it."""
    first, last = draw.choice(chunks(data))
    del data[first:last]


def double_chunk(data: bytearray, draw: random.Random) -> None:
    first, last = draw.choice(chunks(data))
    data[last:last] = data[first:last]


def chunks(data: bytes) -> list[tuple[int, int]]:
    records = top_level(data)
    starts = [first for opcode, first, _ in records if opcode == 6]
    ends = {f: next(x for o, x, _ in records if x > f and o != 7) for f in starts}
    return list(ends.items())


def spoil_summary(data: bytearray, draw: random.Random) -> None:
    end = next(last for opcode, _, last in top_level(data) if opcode == 15)
    data[draw.randrange(end, len(data) - 8)] ^= 1 << draw.randrange(8)


def cut(data: bytearray, draw: random.Random) -> None:
    del data[draw.randrange(8, len(data)) :]


DAMAGES = [
    flip_bit,
    flip_in_head,
    spoil_page,
    drop_record,
    double_record,
    drop_chunk,
    double_chunk,
    spoil_summary,
    cut,
]


@pytest.mark.parametrize("damage", DAMAGES, ids=lambda d: d.__name__)
@pytest.mark.parametrize("compression", ["none", "zstd", "lz4"])
def test_messages_are_right_or_rejected_or_damage_is_reported(
    tmp_path: Path, compression: str, damage
):
    data = (make_bag(tmp_path / "whole", compression) / "bag_0.mcap").read_bytes()
    original = independent(data)
    for seed in range(25):
        spoilt = bytearray(data)
        damage(spoilt, random.Random(seed))
        path = tmp_path / f"bag_{seed}.mcap"
        path.write_bytes(spoilt)
        reported: list[str] = []
        try:
            with open_bag(path, reported.append) as bag:
                found = Counter(
                    (m.topic, m.log_time, m.data, m.publish_time) for m in bag.messages()
                )
                list(bag.attachments())
        except BagError as error:
            reported.append(str(error))
            found = Counter()
        assert set(found) <= set(original), f"seed {seed}: a message that never was"
        assert found == original or reported, f"seed {seed}: a difference without a word"
        assert all("\n" not in line for line in reported)


@pytest.mark.parametrize("compression", ["none", "zstd"])
def test_one_broken_head_costs_no_more_than_what_it_covers(tmp_path: Path, compression: str):
    """Reading continues behind it, with and without the index of the summary; lost messages are counted by topic."""
    data = (make_bag(tmp_path / "whole", compression) / "bag_0.mcap").read_bytes()
    original = independent(data)
    first, _ = chunks(data)[2]
    for case, end in (("index", len(data)), ("none", len(data) - 20)):
        for place in (first, first + 1, first + 6):
            spoilt = bytearray(data[:end])
            spoilt[place] ^= 0x40
            # damage inside of the chunk, too: its checksum cannot verify it
            spoilt[first + 80] ^= 0x01
            path = tmp_path / f"{case}_{place}.mcap"
            path.write_bytes(spoilt)
            report = recover(path, tmp_path / f"{case}_{place}")
            with open_bag(report.bag) as bag:
                found = Counter(
                    (m.topic, m.log_time, m.data, m.publish_time) for m in bag.messages()
                )
            lost = Counter(topic for topic, *_ in (original - found).elements())
            assert 0 < lost.total() < 40
            (damage,) = report.damaged
            known = (
                case == "index" or place != first
            )  # with an intact opcode the record is known as a chunk, and its indexes are used
            assert damage.missing == (lost if known else None)
            (part,) = damage.parts[:1]
            times = [time for _, time, *_ in (original - found).elements()]
            origin = min(time for _, time, *_ in original)
            assert part[2] * 1e9 <= min(times) - origin
            assert max(times) - origin <= part[3] * 1e9


def test_a_chunk_whose_head_alone_is_broken_is_saved_by_its_checksum(tmp_path: Path):
    data = bytearray((make_bag(tmp_path / "whole", "zstd") / "bag_0.mcap").read_bytes())
    original = independent(bytes(data))
    data[chunks(data)[2][0] + 3] ^= 0x10
    (tmp_path / "a.mcap").write_bytes(data)
    recover(tmp_path / "a.mcap", tmp_path / "saved")
    with open_bag(tmp_path / "saved") as bag:
        assert (
            Counter((m.topic, m.log_time, m.data, m.publish_time) for m in bag.messages())
            == original
        )


def bomb(levels: int) -> str:
    """Return YAML whose keys are merged from level to level, tenfold each time."""
    lines = ["a0: &a0 {x: 1}"]
    for i in range(levels):
        lines.append(f"a{i + 1}: &a{i + 1} {{<<: [{', '.join([f'*a{i}'] * 10)}]}}")
    return "\n".join(lines) + "\n"


def test_a_topic_without_messages_is_not_lost_with_the_end_of_a_file(tmp_path: Path):
    """rosbag2 names it only in the summary and in metadata.yaml."""
    path = tmp_path / "bag"
    topic = Topic("/a", "std_msgs/msg/UInt64", 0, "uint64 data\n", "ros2msg", "cdr")
    silent = topic_of("/events", "std_msgs/msg/UInt64", "- depth: 1\n")
    with new_bag(path) as writer:
        for i in range(5):
            writer.write(topic, b"\0\1\0\0" + struct.pack("<Q", i), i + 1, i + 1)
        writer.sync()  # the next messages are in no chunk
        writer.add_topic(silent)
    file = next(path.glob("*.mcap"))
    file.write_bytes(file.read_bytes()[: -len(file.read_bytes()) // 4])
    with open_bag(path, lambda _: None) as bag:
        assert bag.path.name == "bag_recovered"
        assert bag.topics["/a"].count == 5
        found = bag.topics["/events"]
    assert (found.count, found.type_name) == (0, "std_msgs/msg/UInt64")
    assert qos_profiles(found.offered_qos) == [{"depth": 1}]
    assert found.definition


@pytest.mark.parametrize(
    "text",
    [
        bomb(12),
        "rosbag2_bagfile_information: " + "[" * 5000 + "]" * 5000,
        "x: &x [1]\n" + "y: [" + "*x, " * 20_000 + "]\n",
        "x: " + "a" * (17 << 20),
    ],
    ids=["merge keys", "depth", "aliases", "size"],
)
def test_a_hostile_metadata_file_is_rejected_at_once(tmp_path: Path, text: str):
    bag = make_bag(tmp_path / "bag", "none")
    (bag / "metadata.yaml").write_text(text)
    with pytest.raises(BagError, match=r"metadata\.yaml"):
        open_bag(bag)


@pytest.mark.parametrize("seed", range(40))
def test_a_contradicting_metadata_file_is_rejected_or_reported(tmp_path: Path, seed: int):
    """Lines are missing, doubled, or have another digit: the messages are right nevertheless."""
    bag = make_bag(tmp_path / "bag", "zstd")
    original = independent((bag / "bag_0.mcap").read_bytes())
    draw = random.Random(seed)
    lines = (bag / "metadata.yaml").read_text().splitlines()
    place = draw.randrange(len(lines))
    lines[place : place + 1] = draw.choice([[], [lines[place]] * 2, [lines[place] + "7"]])
    (bag / "metadata.yaml").write_text("\n".join(lines) + "\n")
    rejection = ""
    try:
        with open_bag(bag, lambda _: None) as opened:
            found = Counter(
                (m.topic, m.log_time, m.data, m.publish_time) for m in opened.messages()
            )
        assert found == original
    except BagError as error:
        rejection = str(error)
    assert "\n" not in rejection


def test_counts_that_metadata_claims_are_compared(tmp_path: Path):
    bag = make_bag(tmp_path / "bag", "zstd")
    text = (bag / "metadata.yaml").read_text().replace("message_count: 133", "message_count: 134")
    (bag / "metadata.yaml").write_text(text)
    reported: list[str] = []
    open_bag(bag, reported.append).close()
    assert any("134 messages of /worm/b, the bag holds 133" in line for line in reported)


def test_a_file_that_is_listed_twice_is_rejected(tmp_path: Path):
    bag = make_bag(tmp_path / "bag", "zstd")
    text = (bag / "metadata.yaml").read_text()
    text = text.replace("  - bag_0.mcap\n", "  - bag_0.mcap\n  - bag_0.mcap\n")
    (bag / "metadata.yaml").write_text(text)
    with pytest.raises(BagError, match="twice"):
        open_bag(bag)
