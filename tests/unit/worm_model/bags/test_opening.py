# SPDX-License-Identifier: Apache-2.0
"""Bags of all kinds of writers are read, lazily, and each error is one line."""

import struct
import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from mcap.writer import CompressionType, IndexType
from mcap_files import DEFINITION, TYPE, mcap_bytes, payload
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as RosbagsWriter
from rosbags.rosbag2.metadata import parse_qos
from rosbags.typesys import Stores, get_typestore

from worm_model.bags.formats.bag_errors import BagError
from worm_model.bags.formats.bag_metadata import FOREVER, qos_profile, qos_profiles
from worm_model.bags.formats.bag_writer import new_bag
from worm_model.bags.formats.cdr import encode
from worm_model.bags.formats.finding import bags_below
from worm_model.bags.formats.message_block import Topic
from worm_model.bags.formats.message_types import topic_of
from worm_model.bags.opening import Bag, open_bag
from worm_model.bags.run_reader import read_run

COUNT = 500
TOPICS = [Topic(name, TYPE, 0, DEFINITION, "ros2msg", "cdr") for name in ("/a", "/b")]
LATCHED = qos_profile("keep_last", 1, "reliable", "transient_local", "automatic", FOREVER)


def by_rosbags(path: Path, plugin: StoragePlugin, mode: CompressionMode, version: int = 9) -> Path:
    writer = RosbagsWriter(path, version=version, storage_plugin=plugin)
    writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        store = get_typestore(Stores.ROS2_JAZZY)
        connections = [
            writer.add_connection(
                t, TYPE, typestore=store, offered_qos_profiles=parse_qos([LATCHED])
            )
            for t in ("/a", "/b")
        ]
        for i in range(COUNT):
            writer.write(connections[i % 2], i * 1000 + 1, payload(i))
    return path


UNINDEXED = {
    "index_types": IndexType.NONE,
    "use_summary_offsets": False,
    "use_statistics": False,
    "repeat_channels": False,
}


def by_mcap(path: Path, **options) -> Path:
    """Write channels /a and /b; messages in pairs that are out of order within a chunk and across chunks."""
    order = [k for i in range(0, COUNT, 2) for k in (i + 1, i)]
    rows = [(("/a", "/b")[k % 2], k, k * 1000 + 1, k * 1000) for k in order]
    path.write_bytes(mcap_bytes(("/a", "/b"), rows, chunk_size=2000, **options))
    return path


def by_worm_model(path: Path) -> Path:
    with new_bag(path) as writer:
        for i in range(COUNT):
            writer.write(TOPICS[i % 2], payload(i), i * 1000 + 1, i * 1000)
    return path


NONE, STORAGE = CompressionMode.NONE, CompressionMode.STORAGE
WRITERS: dict[str, Callable[[Path], Path]] = {
    "rosbags mcap": lambda d: by_rosbags(d / "bag", StoragePlugin.MCAP, NONE),
    "rosbags mcap version 8": lambda d: by_rosbags(d / "bag", StoragePlugin.MCAP, NONE, 8),
    "rosbags mcap compressed chunks": lambda d: by_rosbags(d / "bag", StoragePlugin.MCAP, STORAGE),
    "rosbags sqlite3": lambda d: by_rosbags(d / "bag", StoragePlugin.SQLITE3, NONE),
    "rosbags sqlite3 version 8": lambda d: by_rosbags(d / "bag", StoragePlugin.SQLITE3, NONE, 8),
    "a sqlite3 file by rosbags": lambda d: next(
        by_rosbags(d / "b", StoragePlugin.SQLITE3, NONE).glob("*.db3")
    ),
    "mcap zstd": lambda d: by_mcap(d / "a.mcap"),
    "mcap lz4": lambda d: by_mcap(d / "a.mcap", compression=CompressionType.LZ4),
    "mcap plain": lambda d: by_mcap(d / "a.mcap", compression=CompressionType.NONE),
    "mcap without chunks": lambda d: by_mcap(d / "a.mcap", use_chunking=False),
    "mcap without index": lambda d: by_mcap(d / "a.mcap", **UNINDEXED),
    "mcap without chunks or index": lambda d: by_mcap(
        d / "a.mcap", use_chunking=False, **UNINDEXED
    ),
    "mcap without schemas in the summary": lambda d: by_mcap(d / "a.mcap", repeat_schemas=False),
    "this writer": lambda d: by_worm_model(d / "bag"),
}


def numbers(bag: Bag, topics: list[str] | None = None) -> list[int]:
    return [struct.unpack_from("<Q", m.data, 4)[0] for m in bag.messages(topics)]


@pytest.mark.parametrize("writer", WRITERS)
def test_bags_of_all_writers_are_read_by_rising_time(tmp_path: Path, writer: str):
    with open_bag(WRITERS[writer](tmp_path)) as bag:
        assert {t.name: (t.type_name, t.count) for t in bag.topics.values()} == {
            "/a": (TYPE, COUNT // 2),
            "/b": (TYPE, COUNT // 2),
        }
        assert bag.spans == [(1, (COUNT - 1) * 1000 + 1)]
        assert numbers(bag) == list(range(COUNT))
        assert numbers(bag, ["/b"]) == list(range(1, COUNT, 2))
        assert numbers(bag, []) == []
        assert sum(len(block) for block in bag.blocks()) == COUNT
        assert sum(len(block) for block in bag.blocks(["/b"])) == COUNT // 2
        if "rosbags" in writer:
            assert qos_profiles(bag.topics["/a"].offered_qos) == [LATCHED]


def test_files_of_a_split_bag_are_one(tmp_path: Path):
    folder = tmp_path / "bag"
    folder.mkdir()
    names = [by_mcap(folder / f"bag_{i}.mcap").name for i in (0, 1, 10)]
    content = {"relative_file_paths": names, "storage_identifier": "mcap"}
    (folder / "metadata.yaml").write_text(yaml.safe_dump({"rosbag2_bagfile_information": content}))
    with open_bag(folder) as bag:
        assert bag.message_count == 3 * COUNT
        assert numbers(bag) == sorted(list(range(COUNT)) * 3)


@pytest.mark.parametrize("indexed", [True, False])
@pytest.mark.parametrize("chunked", [True, False])
def test_equal_times_keep_the_order_of_the_file(tmp_path: Path, chunked: bool, indexed: bool):
    """Also if they are in several chunks, some of which begin before others end."""
    times = [(i // 50) * 50 - 60 * (i % 9 == 0) + 100 for i in range(COUNT)]
    topics = ("/b", "/c", "/a")
    rows = [(topics[i % 3], i, times[i], i) for i in range(COUNT)]
    options = {"chunk_size": 700, "use_chunking": chunked} | ({} if indexed else UNINDEXED)
    (tmp_path / "a.mcap").write_bytes(mcap_bytes(topics, rows, **options))
    expected = sorted(range(COUNT), key=lambda i: times[i])
    with open_bag(tmp_path / "a.mcap") as bag:
        assert numbers(bag) == expected
        assert numbers(bag, ["/a", "/c"]) == [i for i in expected if i % 3]
        assert [m.publish_time for m in bag.messages()] == expected
        assert [m.topic for m in bag.messages()] == [topics[i % 3] for i in expected]
        last = 0
        for block in bag.blocks():
            assert len(block) > 0
            assert int(block.log_time[0]) >= last
            assert (np.diff(block.log_time.astype(np.int64)) >= 0).all()
            last = int(block.log_time[-1])


def count_in_blocks(bag: Bag) -> int:
    return sum(len(block) for block in bag.blocks())


def test_memory_does_not_grow_with_the_length_of_a_bag(tmp_path: Path):
    """Nor with chunks each of which overlaps the next one."""

    def peak(count: int) -> int:
        path = tmp_path / f"{count}"
        with new_bag(path) as writer:
            for i in range(count):
                writer.write(TOPICS[0], payload(i) + bytes(1000), i ^ 511, i)
        with open_bag(path) as bag:
            tracemalloc.start()
            try:
                assert count_in_blocks(bag) == count
                return tracemalloc.get_traced_memory()[1]
            finally:
                tracemalloc.stop()

    short, long = peak(8_000), peak(30_000)
    assert long < 1.3 * short
    assert long < 30_000 * 1000 / 3


def check_one_line(error: pytest.ExceptionInfo[BagError], *facts: str) -> None:
    text = str(error.value)
    assert "\n" not in text
    for fact in facts:
        assert fact in text


@pytest.mark.parametrize(
    ("name", "content", "facts"),
    [
        ("no", None, ["no does not exist"]),
        ("folder/notes.txt", b"x", ["not a bag", "notes.txt"]),
        ("a.mcap", b"", ["empty"]),
        ("a.mcap.zstd", b"", ["compressed as a whole", "zstd -d"]),
        ("a.mcap", b"#ROSBAG V2.0\n", ["a.mcap"]),
        ("a.db3", b"#ROSBAG V2.0\n", ["a.db3"]),
    ],
)
def test_what_is_no_bag_is_rejected(tmp_path: Path, name: str, content, facts: list[str]):
    path = tmp_path / name
    if content is not None:
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(content)
    with pytest.raises(BagError) as error:
        open_bag(path.parent if name.startswith("folder") else path)
    check_one_line(error, *facts)


@pytest.mark.parametrize(
    "text", [None, "", "a: [", "x: 1", "rosbag2_bagfile_information: 3", "\x00", "[" * 5000]
)
def test_a_bag_with_unusable_metadata_is_read_and_the_metadata_reported(tmp_path: Path, text):
    metadata = by_worm_model(tmp_path / "bag") / "metadata.yaml"
    if text is None:
        metadata.unlink()
    else:
        metadata.write_text(text)
    reported: list[str] = []
    with open_bag(tmp_path / "bag", reported.append) as bag:
        assert numbers(bag) == list(range(COUNT))
    (line,) = reported
    assert "metadata.yaml" in line
    assert "\n" not in line


def test_what_is_there_of_a_bag_that_lacks_a_file_is_read(tmp_path: Path):
    metadata = by_worm_model(tmp_path / "bag") / "metadata.yaml"
    metadata.write_text(
        metadata.read_text().replace("- bag_0.mcap\n", "- bag_0.mcap\n  - b.mcap\n")
    )
    with open_bag(tmp_path / "bag", lambda _: None) as bag:
        assert numbers(bag) == list(range(COUNT))
        assert "b.mcap" in bag.damage[0]
    (tmp_path / "bag" / "bag_0.mcap").unlink()
    with pytest.raises(BagError) as error:
        open_bag(tmp_path / "bag", lambda _: None)
    check_one_line(error, "b.mcap does not exist")


POWER = topic_of("/worm/power", "worm_msgs/msg/Power")


@pytest.mark.parametrize(
    ("type_hash", "rejected"),
    [("", False), (POWER.type_hash, False), ("RIHS01_" + 64 * "0", True)],
)
def test_a_bag_without_definitions_is_read_by_the_installed_ones_if_they_fit(
    tmp_path: Path, type_hash: str, rejected: bool
):
    """Sqlite3 bags of ROS 2 Humble contain neither definitions nor type hashes."""
    (data,) = encode(POWER, 1, {"power": 2.5}, {})
    bare = replace(POWER, definition="", metadata=(("topic_type_hash", type_hash),))
    with new_bag(tmp_path / "bag") as writer:
        writer.write(bare, data, 1, 1)
    reported: list[str] = []
    with open_bag(tmp_path / "bag", reported.append) as opened:
        if rejected:
            with pytest.raises(BagError, match="type hash"):
                read_run(opened)
        else:
            assert read_run(opened).power.power.tolist() == [2.5]
    assert any("no definitions of /worm/power;" in line for line in reported)


def test_of_two_definitions_the_one_that_fits_the_hash_is_read(tmp_path: Path):
    """A recording whose definition comes from another workspace, for example."""
    topic = topic_of("/worm/power", "worm_msgs/msg/Power")
    (data,) = encode(topic, 1, {"power": 2.5}, {})
    other = "std_msgs/Header header\nuint8 status\nfloat64 power\n"
    std_msgs = topic.definition[topic.definition.index("=" * 80) :]
    with new_bag(tmp_path / "bag") as writer:
        writer.write(replace(topic, definition=other + std_msgs), data, 1, 1)
    with open_bag(tmp_path / "bag") as bag:
        assert read_run(bag).power.power.tolist() == [2.5]


def made(folder: Path, *names: str) -> None:
    for name in names:
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()


def test_a_folder_a_killed_recorders_folder_and_a_file_are_bags(tmp_path: Path):
    made(tmp_path, "a/closed/metadata.yaml", "a/closed/x.mcap", "killed/killed_0.mcap")
    made(tmp_path, "killed/killed_1.mcap", "loose/one.mcap", "loose/two.db3", "loose/notes.txt")
    names = ["a/closed", "killed", "loose/one.mcap", "loose/two.db3"]
    assert bags_below(tmp_path) == [tmp_path / name for name in names]
    for bag in ("a/closed", "loose/one.mcap"):
        assert bags_below(tmp_path / bag) == [tmp_path / bag]
