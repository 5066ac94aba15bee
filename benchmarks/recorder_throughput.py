# SPDX-License-Identifier: Apache-2.0
"""Throughput of the recorder process, with messages from another process over DDS.

Numbers in the payload show which messages are missing in the bag.
"""

from __future__ import annotations

import json
import os
import random
import signal
import struct
import sys
import tempfile
import time
from pathlib import Path

from benchmarks.publish_load import NUMBER_OFFSET, TOPICS
from benchmarks.report import Row
from worm_model.bags.opening import open_bag
from worm_optimizer.operation.processes import Process, ProcessGroup, executable_command

TITLE = "messages recorded and lost at a given rate, processor time, and what a kill -9 costs"

DOMAIN = 39
SECONDS = 10.0
LOADS = ((5_000, 4_100), (10_000, 2_050), (5_000, 16_000))  # messages/s, bytes
KILLS = 5
TIMEOUT = 60.0


def run() -> list[Row]:
    """Measure several loads, then recordings that are killed at random times."""
    rows = [row for rate, size in LOADS for row in _load(rate, size)]
    return rows + _kills()


def _start(
    group: ProcessGroup, bag: Path, rate: float, size: int, seconds: float
) -> tuple[Process, Process]:
    record = executable_command("worm_model", "record")
    topics = [f"/load_{i}" for i in range(TOPICS)]
    recorder = group.start("recorder", [*record, *topics, "-o", str(bag), "--json"])
    recorder.wait_for_line("recording to", TIMEOUT)
    arguments = [str(rate), str(size), str(seconds)]
    load = group.start("load", [sys.executable, "-m", "benchmarks.publish_load", *arguments])
    return recorder, load


def _environment() -> dict[str, str]:
    root = str(Path(__file__).resolve().parents[1])
    path = os.pathsep.join([root, os.environ.get("PYTHONPATH", "")])
    return {**os.environ, "ROS_DOMAIN_ID": str(DOMAIN), "PYTHONPATH": path}


def _numbers(bag: Path) -> dict[str, list[int]]:
    """Return the recorded numbers by topic."""
    found: dict[str, list[int]] = {}
    with open_bag(bag, lambda _: None) as reader:
        for message in reader.messages():
            (number,) = struct.unpack_from("<Q", message.data, NUMBER_OFFSET)
            found.setdefault(message.topic, []).append(number)
    return found


def _processor_seconds(pid: int) -> float:
    """Return the processor time of a process (s), user and system."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _load(rate: int, size: int) -> list[Row]:
    with (
        tempfile.TemporaryDirectory() as folder,
        ProcessGroup(Path(folder), _environment()) as group,
    ):
        bag = Path(folder, "bag")
        recorder, load = _start(group, bag, rate, size, SECONDS)
        before = _processor_seconds(recorder.pid)
        match = load.wait_for_line(r"^sent (\d+)$", SECONDS + TIMEOUT)
        used = _processor_seconds(recorder.pid) - before
        recorder.interrupt()
        recorder.wait(TIMEOUT)
        lines = recorder.output().splitlines()
        outcome = json.loads(next(line for line in lines if line.startswith("{")))
        numbers = _numbers(bag)
    sent, recorded = int(match[1]), sum(map(len, numbers.values()))
    ordered = all(found == sorted(found) for found in numbers.values()) and len(numbers) == TOPICS
    name = f"{rate} messages/s of {size} B, {rate * size / 1e6:.0f} MB/s"
    rate_recorded = recorded / SECONDS
    return [
        Row(f"{name}: sent", f"{sent / SECONDS:.0f} messages/s", "", "what the load achieved"),
        Row(f"{name}: recorded", f"{rate_recorded:.0f} messages/s", "", f"over {SECONDS:.0f} s"),
        Row(
            f"{name}: missing", f"{sent - recorded} messages", "0", "sent less recorded, by number"
        ),
        Row(f"{name}: reported dropped", f"{outcome['dropped']} messages", "", "by the recorder"),
        Row(f"{name}: order", "kept" if ordered else "lost", "kept", f"in each of {TOPICS} topics"),
        Row(f"{name}: recorder", f"{100.0 * used / SECONDS:.0f} % of a core", "", "processor time"),
    ]


def _kills() -> list[Row]:
    draw = random.Random(1)
    lost, gaps = [], 0
    for _ in range(KILLS):
        with (
            tempfile.TemporaryDirectory() as folder,
            ProcessGroup(Path(folder), _environment()) as group,
        ):
            bag = Path(folder, "bag")
            recorder, _ = _start(group, bag, 5_000, 200, 60.0)
            recorder.wait_for_line("recording /load_9", TIMEOUT)
            time.sleep(draw.uniform(1.0, 3.0))
            recorder.signal(signal.SIGKILL)
            killed = time.time_ns()
            recorder.wait(TIMEOUT)
            with open_bag(bag, lambda _: None) as reader:
                lost.append((killed - reader.spans[-1][1]) * 1e-9)
            gaps += sum(found != list(range(len(found))) for found in _numbers(bag).values())
    how = f"longest of {KILLS}, at seeded random moments of 5000 messages/s"
    return [
        Row("kill -9: lost at the end", f"{max(lost):.2f} s", "1 s", how),
        Row("kill -9: topics with a gap before", str(gaps), "0", f"of {KILLS * TOPICS}"),
    ]
