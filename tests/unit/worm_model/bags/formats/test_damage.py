# SPDX-License-Identifier: Apache-2.0
"""Damaged bags: what is read was recorded, what is missing is reported, and no damage causes a traceback.

An independent reader of the `mcap` library returns the content of a bag before its damage.
"""

import struct
from collections import Counter
from functools import cache
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import CompressionType
from mcap_files import TYPE, mcap_bytes, payload
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as RosbagsWriter
from rosbags.typesys import Stores, get_typestore

from worm_model.bags.formats import mcap_file
from worm_model.bags.formats.bag_errors import BagError
from worm_model.bags.formats.mcap_file import MAGIC, McapFile
from worm_model.bags.opening import open_bag
from worm_model.bags.operations.copies import recover

Row = tuple[str, int, bytes]
TOPICS = ("/worm/a", "/worm/b", "/c")
PLAIN, LZ4, ZSTD = CompressionType.NONE, CompressionType.LZ4, CompressionType.ZSTD


@cache
def original(
    compression: CompressionType = ZSTD, chunked: bool = True, checksums: bool = True, n: int = 30
) -> bytes:
    rows = [(TOPICS[i % 3], i * i, i + 1, i) for i in range(n)]
    checks = {"enable_crcs": checksums, "enable_data_crcs": checksums}
    options = {"chunk_size": 200, "compression": compression, "use_chunking": chunked}
    return mcap_bytes(TOPICS, rows, **options, **checks)


@cache
def sqlite_bytes() -> bytes:
    with TemporaryDirectory() as folder:
        path = Path(folder, "bag")
        with RosbagsWriter(path, version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
            store = get_typestore(Stores.ROS2_JAZZY)
            connection = writer.add_connection("/a", TYPE, typestore=store)
            for i in range(60):
                writer.write(connection, i + 1, payload(i))
        return next(path.glob("*.db3")).read_bytes()


def independent(data: bytes) -> Counter[Row]:
    reader = make_reader(BytesIO(data), validate_crcs=True)
    return Counter((c.topic, m.log_time, m.data) for _, c, m in reader.iter_messages())


def read(path: Path) -> tuple[Counter[Row], list[str]]:
    """Return the messages of a file, and what is reported; a rejection is a report, too."""
    reported: list[str] = []
    found: Counter[Row] = Counter()
    before = path.read_bytes()
    try:
        with open_bag(path, reported.append) as bag:
            found.update((m.topic, m.log_time, m.data) for m in bag.messages())
            list(bag.attachments())
    except BagError as error:
        reported.append(str(error))
    assert path.read_bytes() == before
    assert all("\n" not in line for line in reported)
    return found, reported


def records(data: bytes) -> list[tuple[int, int, int]]:
    """Return opcode, first and last byte of every record of a whole file."""
    found, place = [], len(MAGIC)
    while place < len(data) - len(MAGIC):
        opcode, length = struct.unpack_from("<BQ", data, place)
        found.append((opcode, place, place + 9 + length))
        place += 9 + length
    return found


# --- flips and cuts ---------------------------------------------------------------------------------


@pytest.mark.parametrize("compression", [PLAIN, LZ4, ZSTD])
def test_a_flip_costs_at_most_one_chunk_and_invents_nothing(tmp_path, compression):
    data = original(compression)
    expected = independent(data)
    path = tmp_path / "a.mcap"
    for place in range(len(MAGIC), len(data), 13):
        spoilt = bytearray(data)
        spoilt[place] ^= 1 << place % 8
        path.write_bytes(spoilt)
        found, reported = read(path)
        assert found <= expected, place
        assert found == expected or reported, place
        assert (expected - found).total() <= 5, place


@pytest.mark.parametrize("compression", [PLAIN, ZSTD])
def test_a_file_that_is_cut_keeps_all_whole_chunks(tmp_path: Path, compression):
    data = original(compression)
    expected = independent(data)
    path = tmp_path / "a.mcap"
    path.write_bytes(data)
    file = McapFile(path)
    counts = {e.last: len(file.messages(e, frozenset(TOPICS))) for e in file.extents}
    for cut in range(len(MAGIC), len(data), 13):
        path.write_bytes(data[:cut])
        found, reported = read(path)
        assert found <= expected
        assert found.total() == sum(count for last, count in counts.items() if last <= cut), cut
        assert any("was not closed" in line for line in reported)


def test_a_cut_file_without_chunks_keeps_the_messages_before_the_cut(tmp_path: Path):
    data = original(PLAIN, chunked=False, n=20)
    ends = [last for opcode, _, last in records(data) if opcode == 5]
    path = tmp_path / "a.mcap"
    for cut in range(len(MAGIC), len(data), 19):
        path.write_bytes(data[:cut])
        found, _ = read(path)
        assert found.total() == sum(last <= cut for last in ends), cut


@pytest.mark.parametrize("name", ["a.mcap", "a.db3"])
@settings(max_examples=40, deadline=None)
@given(
    st.lists(
        st.tuples(st.floats(0, 1), st.sampled_from(["flip", "cut", "insert", "lengthen"])),
        min_size=1,
        max_size=4,
    ),
    st.booleans(),
)
def test_no_edits_cause_a_traceback(name: str, edits, chunked: bool):
    data = bytearray(sqlite_bytes() if name == "a.db3" else original(PLAIN, chunked, False))
    for where, what in edits:
        at = min(int(where * len(data)), len(data) - 1)
        if at < 0:
            break
        if what == "flip":
            data[at] ^= 1 + at % 255
        elif what == "cut":
            del data[at:]
        elif what == "insert":
            data[at:at] = bytes([at % 256]) * (at % 7 + 1)
        else:
            data[at : at + 8] = struct.pack("<Q", 2 ** (at % 64))
    with TemporaryDirectory() as folder:
        path = Path(folder, name)
        path.write_bytes(data)
        read(path)


# --- what is reported ---------------------------------------------------------------------------------


def test_the_loss_is_one_line_with_bytes_and_share_which_a_recovered_bag_repeats(tmp_path: Path):
    data = bytearray(original())
    _, first, last = next(record for record in records(data) if record[0] == 6)
    data[last - 20] ^= 1
    path = tmp_path / "a.mcap"
    path.write_bytes(data)
    _, reported = read(path)
    expected = f"{last - first} of its {len(data)} bytes ({(last - first) / len(data):.2%})"
    assert expected in reported[0]
    saved, count, loss = recover(path, None)
    assert expected in loss
    _, reported = read(saved / "a_recovered_0.mcap")
    assert len(reported) == 1
    assert expected in reported[0]
    with open_bag(saved, lambda _: None) as bag:
        assert bag.message_count == count
        assert bag.metadata["worm_run"] == {"seed": "4"}
        assert len(list(bag.attachments())) == 1


def test_a_flip_in_a_metadata_record_is_reported(tmp_path: Path):
    data = original()
    _, first, last = next(record for record in records(data) if record[0] == 12)
    path = tmp_path / "a.mcap"
    for place in range(first, last, 3):
        spoilt = bytearray(data)
        spoilt[place] ^= 0x04
        path.write_bytes(spoilt)
        assert read(path)[1], place


@pytest.mark.parametrize("checksums", [True, False])
def test_a_chunk_that_is_missing_or_there_twice_is_reported(tmp_path: Path, checksums: bool):
    data = original(checksums=checksums)
    _, first, last = [record for record in records(data) if record[0] == 6][2]
    path = tmp_path / "a.mcap"
    for spoilt in (data[:first] + data[last:], data[:last] + data[first:]):
        path.write_bytes(spoilt)
        assert read(path)[1]


def test_a_definition_that_the_data_lost_comes_from_the_summary(tmp_path: Path):
    data = original(PLAIN, chunked=False)
    definitions = [record for record in records(data) if record[0] in (3, 4)][:4]
    spoilt = bytearray(data)
    for _, first, _ in definitions:
        spoilt[first] = 0x7F  # a kind that does not exist
    path = tmp_path / "a.mcap"
    path.write_bytes(spoilt)
    assert read(path)[0] == independent(data)


def test_bytes_after_the_end_are_reported(tmp_path: Path):
    path = tmp_path / "a.mcap"
    path.write_bytes(original() * 2)
    found, reported = read(path)
    assert found == independent(original())
    assert any(f"{len(original())} bytes after its end" in line for line in reported)


@pytest.mark.parametrize("compression", [LZ4, ZSTD])
def test_a_chunk_that_declares_too_many_bytes_is_skipped(tmp_path, monkeypatch, compression):
    data = original(compression)
    sizes = [
        struct.unpack_from("<Q", data, first + 25)[0]
        for kind, first, _ in records(data)
        if kind == 6
    ]
    monkeypatch.setattr(mcap_file, "LARGEST_CHUNK", max(sizes) - 1)
    path = tmp_path / "a.mcap"
    path.write_bytes(data)
    found, reported = read(path)
    assert found < independent(data)
    assert reported


# --- later versions of the format ---------------------------------------------------------------------


def changed(data: bytes, change) -> bytes:
    """Return a file with other records; the offsets and checksums of its summary are omitted."""
    body = bytearray(MAGIC)
    for opcode, first, last in records(data):
        content = data[first + 9 : last]
        if opcode == 2:
            content = bytes(20)
        if opcode == 15:
            content = bytes(4)
        for kind, part in change(opcode, content):
            body += struct.pack("<BQ", kind, len(part)) + part
    return bytes(body + MAGIC)


def longer(opcode: int, content: bytes):
    """Add fields at the end of each record, except a message, whose payload has no length."""
    return [(opcode, content if opcode == 5 else content + b"later")]


def reserved(opcode: int, content: bytes):
    """Add a record of a reserved kind and one of a private kind before each record."""
    return [(0x42, b"reserved" * 3), (0x99, b""), (opcode, content)]


@pytest.mark.parametrize("change", [longer, reserved])
@pytest.mark.parametrize("chunked", [True, False])
def test_a_file_of_a_later_version_is_read_without_a_word(tmp_path: Path, chunked: bool, change):
    data = original(ZSTD, chunked)
    path = tmp_path / "a.mcap"
    path.write_bytes(changed(data, change))
    found, reported = read(path)
    assert found == independent(data)
    assert reported == []
    file = McapFile(path)
    assert [record.name for record in file.metadata] == ["worm_run"]
    assert [attached.name for attached in file.attachments] == ["parameters.yaml"]
    file.close()
