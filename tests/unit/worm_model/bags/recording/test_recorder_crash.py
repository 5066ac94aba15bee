# SPDX-License-Identifier: Apache-2.0
"""Content of a bag whose recorder is killed."""

import random
import struct
import subprocess
import sys
import time
from pathlib import Path

import pytest
from rosbags.highlevel import AnyReader

from worm_model.bags.opening import Bag, open_bag
from worm_model.bags.operations.copies import recover

SOURCES = [
    str(Path(__file__).resolve().parents[5] / "src" / package)
    for package in ("worm_msgs", "worm_driver", "worm_model")
]

# Records a counter as fast as possible, and prints after each synchronisation how many messages are safe.
RECORD = """
import struct, sys
from pathlib import Path
from worm_model.bags.formats.message_block import Message, Topic
from worm_model.bags.recording import recorder
from worm_model.bags.recording.recorder import BagRecorder, Manifest

class Telling(BagRecorder):
    def sync(self):
        safe = sum(self._counts.values())
        super().sync()
        print(safe, flush=True)

topic = Topic("/counter", "std_msgs/msg/UInt64", 0, "uint64 data\\n", "ros2msg", "cdr")
recorder.SYNC_S = 0.02
bag = Telling(Path(sys.argv[1]), Manifest({"worm_run": {"seed": "4"}}))
count = 0
while True:
    bag.record([
        Message(topic.name, i + 1, b"\\0\\1\\0\\0" + struct.pack("<Q", i), i + 1, topic)
        for i in range(count, count + 100)
    ])
    count += 100
"""


def start(bag: Path) -> subprocess.Popen:
    return subprocess.Popen(
        [sys.executable, "-c", RECORD, str(bag)],
        stdout=subprocess.PIPE,
        text=True,
        env={"PYTHONPATH": ":".join(SOURCES), "PATH": "/usr/bin:/bin"},
    )


def counters(bag: Bag) -> list[int]:
    return [struct.unpack_from("<Q", message.data, 4)[0] for message in bag.messages()]


@pytest.mark.parametrize("seed", range(3))
def test_a_killed_recorder_loses_nothing_that_was_synchronised(tmp_path: Path, seed: int):
    draw = random.Random(seed)
    bag = tmp_path / "bag"
    with start(bag) as process:
        safe = 0
        for _ in range(draw.randrange(1, 5)):
            safe = int(process.stdout.readline())
        while safe == 0:  # a recorder on a busy machine synchronises before its first message
            safe = int(process.stdout.readline())
        # the time of the kill is random, without waiting for a condition
        time.sleep(draw.uniform(0.0, 0.04))
        process.kill()
        safe = max([safe, *map(int, process.stdout.read().split())])
    before = {path.name: path.read_bytes() for path in bag.iterdir()}
    reported: list[str] = []
    with open_bag(bag, reported.append) as recovered:
        found = counters(recovered)
        assert recovered.metadata["worm_run"] == {"seed": "4"}
    assert found == list(range(len(found)))
    assert len(found) >= safe > 0
    assert len(reported) == 1
    assert "was not closed" in reported[0]
    assert recover(bag, None)[:2] == (tmp_path / "bag_recovered", len(found))
    assert {path.name: path.read_bytes() for path in bag.iterdir()} == before
    with AnyReader([tmp_path / "bag_recovered"]) as reader:
        assert reader.message_count == len(found)
