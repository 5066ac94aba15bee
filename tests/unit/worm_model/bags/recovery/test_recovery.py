# SPDX-License-Identifier: Apache-2.0
"""`recover` against the `mcap` library's stream reader, which stops at the first damage."""

import os
import random
import sqlite3
import struct
import subprocess
import sys
import zlib
from collections import Counter
from collections.abc import Iterator
from contextlib import closing, suppress
from functools import cache
from io import BytesIO
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory

import lz4.frame
import pytest
import zstandard
from hypothesis import example, given, settings
from hypothesis import strategies as st
from mcap.opcode import Opcode
from mcap.records import Channel, Message, Schema
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as RosbagsWriter
from rosbags.typesys import Stores, get_typestore

from worm_model.bags.formats.bag_errors import BagError
from worm_model.bags.formats.bag_writer import BagFiles, WriteOptions
from worm_model.bags.formats.mcap_records import LARGEST_CHUNK, MAGIC
from worm_model.bags.formats.mcap_walk import DAMAGED, Walk, is_intact_chunk
from worm_model.bags.formats.message_block import Topic
from worm_model.bags.formats.sqlite_file import SqliteFile
from worm_model.bags.opening import open_bag
from worm_model.bags.recovery.recovery import recover
from worm_model.commands import bags

SAMPLES = Path(__file__).resolve().parents[5] / "bags"
COUNT = 240
NAMES = ("/a", "/b", "/c")
Row = tuple[str, int, bytes]

#: a layout: chunks or none, their compression, checksums or none
LAYOUTS = {
    "zstd": (True, CompressionType.ZSTD, True),
    "lz4": (True, CompressionType.LZ4, True),
    "plain": (True, CompressionType.NONE, True),
    "rosbag2": (True, CompressionType.NONE, False),
    "rosbag2 zstd": (True, CompressionType.ZSTD, False),
    "without chunks": (False, CompressionType.NONE, True),
}


@cache
def file_of(layout: str, count: int = COUNT) -> bytes:
    chunked, compression, checksums = LAYOUTS[layout]
    stream = BytesIO()
    writer = Writer(
        stream,
        chunk_size=700,
        use_chunking=chunked,
        compression=compression,
        enable_crcs=checksums,
    )
    writer.start("ros2")
    schema = writer.register_schema("std_msgs/msg/UInt64", "ros2msg", b"uint64 data\n")
    channels = [writer.register_channel(name, "cdr", schema) for name in NAMES]
    draw = random.Random(7)
    for i in range(count):
        data = b"\0\1\0\0" + draw.randbytes(8)
        writer.add_message(channels[i % 3], 1_000_000 * (i + 1), data, i)
    writer.finish()
    return stream.getvalue()


def by_stream_reader(data: bytes) -> list[Row]:
    """Return the messages up to the first damage for which a definition of their channel precedes them."""
    topics: dict[int, str] = {}
    rows: list[Row] = []
    with suppress(Exception):
        for record in StreamReader(BytesIO(data), validate_crcs=True).records:
            if isinstance(record, Channel):
                topics.setdefault(record.id, record.topic)
            elif isinstance(record, Message) and record.channel_id in topics:
                rows.append((topics[record.channel_id], record.log_time, record.data))
            elif isinstance(record, Schema):
                continue
    return rows


def recovered(data: bytes) -> list[Row]:
    with TemporaryDirectory() as folder:
        path = Path(folder, "a.mcap")
        path.write_bytes(data)
        try:
            recover(path, Path(folder, "saved"))
        except BagError:  # no message is left
            return []
        with open_bag(Path(folder, "saved"), lambda _: None) as bag:
            return [(m.topic, m.log_time, m.data) for m in bag.messages()]


def chunks(data: bytes) -> Iterator[tuple[int, int]]:
    """Yield first and last byte of each chunk of an undamaged file."""
    place = len(MAGIC)
    while place < len(data) - len(MAGIC):
        opcode, length = struct.unpack_from("<BQ", data, place)
        if opcode == Opcode.CHUNK:
            yield place, place + 9 + length
        place += 9 + length


EDITS = st.lists(
    st.tuples(st.sampled_from(["cut", "flip", "insert", "delete", "double"]), st.floats(0, 1)),
    min_size=1,
    max_size=3,
)


def edit(data: bytes, edits: list[tuple[str, float]]) -> bytes:
    edited = bytearray(data)
    for what, where in edits:
        place = len(MAGIC) + int(where * (len(edited) - len(MAGIC) - 1))
        draw = random.Random(place)
        span = slice(place, place + draw.randrange(1, 900))
        if what == "cut":
            del edited[place:]
        elif what == "flip" and place < len(edited):
            edited[place] ^= 1 << draw.randrange(8)
        elif what == "insert":
            edited[place:place] = draw.randbytes(draw.randrange(1, 40))
        elif what == "delete":
            del edited[span]
        elif what == "double":
            edited[place:place] = edited[span]
    return bytes(edited)


@pytest.mark.parametrize("layout", LAYOUTS)
@settings(max_examples=60, deadline=None, derandomize=True)
@given(edits=EDITS)
@example(
    edits=[("cut", 0.1875), ("cut", 0.21875), ("flip", 0.0)]
)  # header damaged, cut after a chunk
@example(edits=[("cut", 0.25), ("flip", 0.048828125)])  # "rosbag2": the length of a definition
@example(edits=[("flip", 0.6875)])  # "rosbag2 zstd": the length of a chunk's compressed bytes
@example(edits=[("flip", 0.7811433250333382)])  # "rosbag2": the length of a chunk's last message
def test_it_saves_what_the_stream_reader_returns_and_every_intact_chunk(layout: str, edits):
    data = file_of(layout)
    damaged = edit(data, edits)
    original, saved = Counter(by_stream_reader(data)), Counter(recovered(damaged))
    returned = Counter(by_stream_reader(damaged))  # some are altered if no checksum shows it
    assert (returned & original) - saved == Counter()
    chunked, _, checksums = LAYOUTS[layout]
    if not (chunked and checksums):
        return
    assert set(saved) <= set(original)
    begin, end = next(chunks(data))
    if data[begin:end] in damaged:  # the chunk with the definitions
        for first, last in chunks(data):
            if data[first:last] in damaged:
                inside = data[: len(MAGIC)] + data[begin:end] + data[first:last]
                assert (
                    Counter(by_stream_reader(inside)) - Counter(2 * [*saved.elements()])
                    == Counter()
                )


@pytest.mark.parametrize("layout", ["lz4", "plain", "rosbag2", "rosbag2 zstd", "zstd"])
@pytest.mark.parametrize("bit", [0, 2, 7, 20, 28, 40, 63])
def test_a_damaged_size_of_a_chunk_costs_nothing(layout: str, bit: int):
    data = file_of(layout)
    _, (first, _) = islice(chunks(data), 2)
    size = slice(first + 9 + 16, first + 9 + 24)
    damaged = data[: size.start] + with_flip(data[size], bit) + data[size.stop :]
    assert Counter(recovered(damaged)) == Counter(by_stream_reader(data))


@pytest.mark.parametrize("sample", ["forward/forward_0.mcap", "killed/killed_0.mcap"])
@pytest.mark.parametrize("seed", range(6))
def test_a_random_cut_costs_no_more_than_what_is_behind_it(tmp_path: Path, sample: str, seed: int):
    """Apply twelve cuts to recorded bags."""
    data = (SAMPLES / sample).read_bytes()
    cut = data[: random.Random(seed).randrange(len(data) // 20, len(data))]
    assert Counter(by_stream_reader(cut)) == Counter(recovered(cut)) != Counter()


@pytest.mark.parametrize("seed", range(6))
def test_a_flipped_index_costs_nothing(tmp_path: Path, seed: int):
    data = bytearray((SAMPLES / "forward" / "forward_0.mcap").read_bytes())
    original = Counter(by_stream_reader(bytes(data)))
    draw = random.Random(seed)
    indexes, place = [], len(MAGIC)
    while data[place] != Opcode.DATA_END:
        opcode, length = struct.unpack_from("<BQ", data, place)
        if opcode == Opcode.MESSAGE_INDEX:
            indexes.append((place, place + 9 + length))
        place += 9 + length
    first, last = draw.choice(indexes)
    data[draw.randrange(first, last)] ^= 1 << draw.randrange(8)
    assert Counter(recovered(bytes(data))) == original


# --- bombs ----------------------------------------------------------------------------------------


def bomb(compression: str, declared: int, size: int) -> bytes:
    """Write a file with a chunk of zeros."""
    if compression == "zstd":
        compressor = zstandard.ZstdCompressor(level=1).compressobj()
        parts = [compressor.compress(bytes(1 << 24)) for _ in range(size >> 24)]
        packed = b"".join([*parts, compressor.flush()])
    else:
        packed = lz4.frame.compress(bytes(size))
    name = compression.encode()
    body = struct.pack("<QQQII", 1, 2, declared, 1, len(name)) + name
    body += struct.pack("<Q", len(packed)) + packed
    whole = file_of("zstd")
    place = whole.index(bytes([Opcode.DATA_END]) + struct.pack("<Q", 4))
    return whole[:place] + struct.pack("<BQ", Opcode.CHUNK, len(body)) + body


LIMITED = """
import resource, sys
from pathlib import Path
resource.setrlimit(resource.RLIMIT_AS, (3_500_000_000,) * 2)
from worm_model.bags.recovery.recovery import recover
from worm_model.commands import bags
print(recover(Path(sys.argv[1]), Path(sys.argv[2])).messages)
"""


@pytest.mark.parametrize(
    ("compression", "declared", "size"),
    [
        ("zstd", 1 << 33, 1 << 33),
        ("zstd", 1000, 1 << 33),
        ("lz4", LARGEST_CHUNK, 1 << 30),
        ("zstd", LARGEST_CHUNK, LARGEST_CHUNK),
    ],
)
def test_a_bomb_costs_its_own_chunk(tmp_path: Path, compression: str, declared: int, size: int):
    path = tmp_path / "bomb.mcap"
    path.write_bytes(bomb(compression, declared, size))
    process = subprocess.run(
        [sys.executable, "-c", LIMITED, str(path), str(tmp_path / "saved")],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), "OPENBLAS_NUM_THREADS": "1"},
    )
    assert process.returncode == 0, process.stderr
    assert int(process.stdout) == COUNT


# --- files without chunks, and bytes between records ----------------------------------------------


@pytest.mark.parametrize("seed", range(10))
def test_a_wrong_length_costs_its_own_message(seed: int):
    data = bytearray(file_of("without chunks"))
    original = by_stream_reader(bytes(data))
    record = 31 + 12
    first = data.index(original[0][2]) - 31
    row = random.Random(seed).randrange(COUNT - 1)
    data[first + row * record + 1 + seed % 8] ^= 0x10 << seed % 3
    assert original[:row] + original[row + 1 :] == recovered(bytes(data))


@pytest.mark.parametrize("seed", range(4))
def test_random_bytes_hold_no_plausible_record(seed: int):
    """A plausible record is whole, and so is the record behind it: see `mcap_walk`."""
    draw = random.Random(seed)
    noise = bytearray(draw.randbytes(1 << 20))
    for place in range(0, len(noise) - 40, 50):  # heads of messages without a record behind them
        struct.pack_into("<BQH", noise, place, Opcode.MESSAGE, draw.randrange(22, 30), 1)
    parts = list(Walk(b"\0" + bytes(noise), 0, {1}, is_intact_chunk))
    assert [part.opcode for part in parts] == [DAMAGED]


@pytest.mark.parametrize("sample", ["forward/forward_0.mcap", "faults/faults_0.mcap"])
def test_recorded_payloads_hold_no_plausible_record(sample: str):
    with open_bag(SAMPLES / sample, lambda _: None) as bag:
        payloads = b"".join(message.data for message in bag.messages())
    parts = list(Walk(b"\0" + payloads, 0, set(range(40)), is_intact_chunk))
    assert [part.opcode for part in parts] == [DAMAGED]


# --- definitions and metadata ---------------------------------------------------------------------


@pytest.mark.parametrize("layout", ["rosbag2", "rosbag2 zstd", "without chunks"])
@pytest.mark.parametrize("bit", [0, 1, 4, 6, 13, 37, 62])
def test_a_definition_with_a_damaged_length_is_saved(layout: str, bit: int):
    """The stream reader ignores this length inside of a chunk."""
    data = file_of(layout)
    data = data[: len(data) // 3]  # without the copy in the summary
    head = struct.pack("<BQHHI", Opcode.CHANNEL, 21, 3, 1, 2) + b"/c"
    if layout == "rosbag2 zstd":
        first, last = next(chunks(data))
        body = data[first + 9 + 44 : last]
        records = zstandard.decompress(body, 4000)
        assert head in records
        packed = zstandard.compress(records.replace(head, with_flip(head, 8 + bit)))
        fields = struct.unpack_from("<QQQII", data, first + 9)
        fixed = struct.pack("<QQQII", *fields) + b"zstd" + struct.pack("<Q", len(packed)) + packed
        damaged = data[:first] + struct.pack("<BQ", Opcode.CHUNK, len(fixed)) + fixed + data[last:]
    else:
        assert head in data
        damaged = data.replace(head, with_flip(head, 8 + bit), 1)
    assert (
        Counter(recovered(damaged)) == Counter(recovered(data)) >= Counter(by_stream_reader(data))
    )


def with_flip(data: bytes, bit: int) -> bytes:
    flipped = bytearray(data)
    flipped[bit // 8] ^= 1 << bit % 8
    return bytes(flipped)


def test_messages_of_a_damaged_chunk_are_no_plain_messages():
    """The only chunk is cut off, and a message in it is altered: its checksum cannot show which."""
    data = bytearray(file_of("plain"))
    first, last = next(chunks(bytes(data)))
    del data[last - 60 :]
    data[last - 300] ^= 1
    assert set(recovered(bytes(data))) <= set(by_stream_reader(file_of("plain")))
    data[first + 9 + 3] ^= 1  # a time in the chunk's head
    assert set(recovered(bytes(data))) <= set(by_stream_reader(file_of("plain")))


def test_messages_that_nothing_verifies_are_reported(tmp_path: Path):
    data = bytearray(file_of("without chunks"))
    place = data.index(by_stream_reader(bytes(data))[9][2])
    data[place - 30] ^= 0x40  # a length
    path = tmp_path / "a.mcap"
    path.write_bytes(data)
    (damage,) = recover(path, tmp_path / "saved").damaged
    assert any("checksum" in line and str(COUNT - 1) in line for line in damage.contradictions)


def make_bag(folder: Path, count: int = 300, split: int = 0) -> Path:
    folder.mkdir()
    files = BagFiles(folder, folder.name, WriteOptions("zstd", chunk_bytes=600, split_bytes=split))
    files.add_metadata("worm_run", {"seed": "4", "parameter_file": "robot.yaml"})
    topics = [Topic(n, "std_msgs/msg/UInt64", 0, "uint64 data\n", "ros2msg", "cdr") for n in NAMES]
    draw = random.Random(5)
    for i in range(count):
        files.write(topics[i % 3], b"\0\1\0\0" + draw.randbytes(8), 10**9 + 10**6 * i, i)
    files.finish()
    return folder


def test_every_flip_in_a_metadata_record_is_reported(tmp_path: Path):
    data = (make_bag(tmp_path / "bag") / "bag_0.mcap").read_bytes()
    first = data.index(b"worm_run") - 4
    for place in range(first, data.index(b"robot.yaml") + 10):
        damaged = bytearray(data)
        damaged[place] ^= 1
        path = tmp_path / f"{place}.mcap"
        path.write_bytes(damaged)
        reported: list[str] = []
        with open_bag(path, reported.append) as bag:
            assert bag.message_count == 300
        assert reported


def test_the_checksum_of_the_data_section_is_written(tmp_path: Path):
    data = (make_bag(tmp_path / "bag") / "bag_0.mcap").read_bytes()
    place = data.rindex(bytes([Opcode.DATA_END]) + struct.pack("<Q", 4))
    (checksum,) = struct.unpack_from("<I", data, place + 9)
    assert checksum == zlib.crc32(data[:place])
    list(StreamReader(BytesIO(data), validate_crcs=True).records)


def test_a_damaged_copy_in_the_summary_does_not_replace_a_definition(tmp_path: Path):
    data = bytearray(file_of("rosbag2"))  # this bag's summary has no checksum
    place = data.rindex(b"uint64 data")
    assert data.index(b"uint64 data") < place
    data[place] ^= 1
    path = tmp_path / "a.mcap"
    path.write_bytes(data)
    reported: list[str] = []
    with open_bag(path, reported.append) as bag:
        assert {topic.definition for topic in bag.topics.values()} == {"uint64 data\n"}
        assert bag.message_count == COUNT
    assert reported
    recover(path, tmp_path / "saved")
    with open_bag(tmp_path / "saved", reported.append) as bag:
        assert {topic.definition for topic in bag.topics.values()} == {"uint64 data\n"}


def test_a_definition_that_the_data_lost_comes_from_the_summary(tmp_path: Path):
    data = bytearray(file_of("zstd"))
    _, last = next(chunks(bytes(data)))
    data[last - 10] ^= 1  # the chunk with the definitions
    path = tmp_path / "a.mcap"
    path.write_bytes(data)
    report = recover(path, tmp_path / "saved")
    assert 0 < COUNT - report.messages < 30
    (damage,) = report.damaged
    assert sum((damage.missing or {}).values()) == COUNT - report.messages
    assert {name for name in NAMES if any(name in line for line in damage.contradictions)} == {
        *NAMES
    }


# --- the loss is stored ---------------------------------------------------------------------------


def test_the_loss_is_repeated_whenever_the_recovered_bag_is_opened(tmp_path: Path):
    bag = make_bag(tmp_path / "bag")
    file = bag / "bag_0.mcap"
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    lines = []
    for path in (bag, bag, tmp_path / "bag_recovered"):
        reported: list[str] = []
        open_bag(path, reported.append).close()
        (line,) = reported
        lines.append(line)
    with open_bag(tmp_path / "bag_recovered", lambda _: None) as opened:
        loss = opened.metadata["worm_recovery"]["loss"]
    assert "bag_0.mcap" in loss
    assert all(loss in line for line in lines)


# --- several files --------------------------------------------------------------------------------


@pytest.fixture
def split(tmp_path: Path) -> Path:
    bag = make_bag(tmp_path / "bag", count=1500, split=12_000)
    assert len(list(bag.glob("*.mcap"))) > 3
    return bag


def test_the_other_files_and_the_intact_part_of_a_damaged_one_are_saved(split: Path):
    whole = {file.name: by_stream_reader(file.read_bytes()) for file in split.glob("*.mcap")}
    file = split / "bag_1.mcap"
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    part = by_stream_reader(file.read_bytes())
    report = recover(split)
    assert [damage.file for damage in report.damaged] == ["bag_1.mcap"]
    assert 0 < len(part) < len(whole["bag_1.mcap"])
    assert report.messages == 1500 - len(whole["bag_1.mcap"]) + len(part)


@pytest.mark.parametrize("described", [True, False])
def test_a_missing_file_in_the_middle_is_reported(split: Path, described: bool):
    lost = len(by_stream_reader((split / "bag_1.mcap").read_bytes()))
    (split / "bag_1.mcap").unlink()
    if not described:
        (split / "metadata.yaml").unlink()
    report = recover(split)
    assert report.absent == ("bag_1.mcap",)
    assert "bag_1.mcap" in report.loss
    assert report.messages == 1500 - lost


def test_a_file_of_something_else_does_not_hinder_the_others(split: Path):
    (split / "bag_1.mcap").write_bytes(b"something else")
    report = recover(split)
    assert list(report.unreadable or {}) == ["bag_1.mcap"]
    assert report.messages > 500


# --- sqlite3 --------------------------------------------------------------------------------------


@pytest.fixture
def sqlite_bag(tmp_path: Path) -> Path:
    path = tmp_path / "bag"
    with RosbagsWriter(path, version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        store = get_typestore(Stores.ROS2_JAZZY)
        connection = writer.add_connection("/a", "std_msgs/msg/UInt64", typestore=store)
        for i in range(5000):
            writer.write(connection, i + 1, b"\0\1\0\0" + struct.pack("<Q", i))
    return path


def test_a_damaged_page_costs_its_own_rows(sqlite_bag: Path, tmp_path: Path):
    file = next(sqlite_bag.glob("*.db3"))
    data = bytearray(file.read_bytes())
    place = data.index(b"\0\1\0\0" + struct.pack("<Q", 2500)) // 4096 * 4096
    data[place : place + 4096] = bytes(4096)
    file.write_bytes(data)
    reported: list[str] = []
    with open_bag(sqlite_bag, reported.append) as bag:
        found = [struct.unpack_from("<Q", m.data, 4)[0] for m in bag.messages()]
    assert 4700 < len(found) < 5000
    missing = sorted(set(range(5000)) - set(found))
    assert missing == list(range(missing[0], missing[-1] + 1))  # a page of consecutive rows
    assert "5000" in reported[0] or str(5000 - len(found)) in reported[0]


@pytest.mark.parametrize("share", [0.3, 0.6, 0.95])
def test_a_cut_sqlite3_file_keeps_what_sqlite_can_read(sqlite_bag: Path, share: float):
    file = next(sqlite_bag.glob("*.db3"))
    data = file.read_bytes()
    file.write_bytes(data[: int(share * len(data))])
    report = recover(sqlite_bag)
    assert report.messages > 5000 * (share - 0.3) * 0.5
    (damage,) = report.damaged
    assert not damage.is_closed
    assert (report.undeclared or {})["/a"] == 5000 - report.messages


def test_a_file_in_which_sqlite_finds_no_table_is_not_said_to_be_recoverable(sqlite_bag: Path):
    file = next(sqlite_bag.glob("*.db3"))
    data = bytearray(file.read_bytes())
    data[16:18] = b"\xff\xff"  # no size of a page
    file.write_bytes(data)
    with pytest.raises(BagError, match="no table of messages"):
        SqliteFile(file)


def test_a_journal_is_read_too(tmp_path: Path):
    """rosbag2 lets SQLite write ahead: the messages of a killed recorder are in the file next to the database."""
    path = tmp_path / "live.db3"
    database = sqlite3.connect(path)
    database.execute("PRAGMA journal_mode = WAL")
    database.execute("PRAGMA wal_autocheckpoint = 0")
    database.execute(
        "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT, "
        "offered_qos_profiles TEXT)"
    )
    database.execute(
        "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB)"
    )
    database.execute("INSERT INTO topics VALUES(1, '/a', 'std_msgs/msg/UInt64', 'cdr', '')")
    rows = [(1, i + 1, b"\0\1\0\0" + struct.pack("<Q", i)) for i in range(100)]
    database.executemany("INSERT INTO messages(topic_id, timestamp, data) VALUES(?, ?, ?)", rows)
    database.commit()
    killed = tmp_path / "killed.db3"
    killed.write_bytes(path.read_bytes())
    Path(f"{killed}-wal").write_bytes(Path(f"{path}-wal").read_bytes())
    database.close()
    before = killed.read_bytes()
    with open_bag(killed, lambda _: None) as bag:
        assert bag.message_count == 100
    assert killed.read_bytes() == before


def test_a_wrong_count_in_metadata_is_reported_for_sqlite3_as_for_mcap(sqlite_bag: Path):
    metadata = sqlite_bag / "metadata.yaml"
    metadata.write_text(metadata.read_text().replace("message_count: 5000", "message_count: 5001"))
    reported: list[str] = []
    with open_bag(sqlite_bag, reported.append) as bag:
        assert sum(1 for _ in bag.messages()) == 5000
    assert any("5001" in line and "5000" in line and "/a" in line for line in reported)


def test_a_row_with_another_type_is_left_out(sqlite_bag: Path):
    file = next(sqlite_bag.glob("*.db3"))
    with closing(sqlite3.connect(file)) as database, database:
        database.execute("UPDATE messages SET timestamp = 'x' WHERE id = 7")
        database.execute("UPDATE messages SET topic_id = 99 WHERE id = 9")
    with open_bag(sqlite_bag, lambda _: None) as bag:
        assert bag.message_count == 4998


# --- folders and files without a bag --------------------------------------------------------------


@pytest.mark.parametrize("name", ["pipe.mcap", "pipe.db3"])
def test_a_named_pipe_is_rejected(tmp_path: Path, name: str):
    os.mkfifo(tmp_path / name)
    for act in (open_bag, recover):
        with pytest.raises(BagError, match="named pipe"):
            act(tmp_path / name)


def test_a_named_pipe_in_the_place_of_metadata_is_rejected(tmp_path: Path):
    bag = make_bag(tmp_path / "bag")
    (bag / "metadata.yaml").unlink()
    os.mkfifo(bag / "metadata.yaml")
    with pytest.raises(BagError, match=r"metadata\.yaml"):
        open_bag(bag)
    assert recover(bag).messages == 300


def test_a_loop_of_links_is_no_missing_file(tmp_path: Path):
    (tmp_path / "a.mcap").symlink_to(tmp_path / "a.mcap")
    with pytest.raises(BagError, match="symbolic links"):
        open_bag(tmp_path / "a.mcap")


def test_a_time_after_all_clocks_is_no_duration(tmp_path: Path):
    data = bytearray(file_of("without chunks"))
    struct.pack_into("<Q", data, data.index(by_stream_reader(bytes(data))[-1][2]) - 16, 2**64 - 1)
    path = tmp_path / "a.mcap"
    path.write_bytes(data)
    reported: list[str] = []
    with open_bag(path, reported.append) as bag:
        assert bag.end == 1_000_000 * (COUNT - 1)
        assert bag.message_count == COUNT
    assert any("2262" in line for line in reported)


def test_a_folder_whose_name_is_not_utf_8(tmp_path: Path, monkeypatch, capsys):
    """Its name is a byte of latin-1; commands print an escape for it."""
    folder = Path(os.fsdecode(os.fsencode(tmp_path) + b"/lat\xe9in"))
    bag = make_bag(folder)
    (bag / "metadata.yaml").unlink()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    for arguments in (["table", str(tmp_path)], ["info", str(bag)], ["table", str(tmp_path)]):
        monkeypatch.setattr("sys.argv", ["bags", *arguments])
        assert bags.main() == 0
    assert "lat\\udce9in" in capsys.readouterr().out
    with open_bag(bag, lambda _: None) as opened:
        assert opened.message_count == 300
    assert (
        sum(path.is_dir() for path in tmp_path.iterdir()) == 3
    )  # with its recovery, and the cache


def test_metadata_with_a_million_keys_is_rejected(tmp_path: Path):
    bag = make_bag(tmp_path / "bag")
    with (bag / "metadata.yaml").open("a") as stream:
        stream.writelines(f"k{i}: 1\n" for i in range(1_200_000))
    with pytest.raises(BagError, match=r"metadata\.yaml"):
        open_bag(bag)
    assert recover(bag).messages == 300


@pytest.mark.parametrize("end", ["8", "8.0000001"])
def test_a_span_without_messages_is_not_trimmed(tmp_path: Path, monkeypatch, capsys, end: str):
    output = tmp_path / "part"
    arguments = ["trim", str(SAMPLES / "forward"), "--start", "8", "--end", end]
    monkeypatch.setattr("sys.argv", ["bags", *arguments, "--output", str(output)])
    assert bags.main() == 2
    assert "8.000 s" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_zeros_at_the_end_are_one_damaged_part():
    """A power cut leaves zeros; 57 of them look like an empty chunk."""
    data = file_of("rosbag2 zstd")
    zeros = data[: next(chunks(data))[1]] + bytes(1 << 20)
    parts = list(Walk(zeros, len(MAGIC), set(), is_intact_chunk))
    assert [part.opcode for part in parts] == [Opcode.HEADER, Opcode.CHUNK, DAMAGED]
