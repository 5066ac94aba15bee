# SPDX-License-Identifier: Apache-2.0
"""Load of the twin node with lengths at 1 kHz: its share of a core, and its latency from a sample to its state."""

from __future__ import annotations

import os
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from rclpy.qos import DurabilityPolicy, QoSProfile

from benchmarks.report import Row
from worm_model.gait import Gait
from worm_msgs.msg import BodyLength, GaitState, TwinState
from worm_msgs.msg import Gait as GaitMessage
from worm_msgs.ros_process import freeze_garbage_collection
from worm_optimizer.operation.processes import ProcessGroup, executable_command, wait_for

TITLE = "twin node: share of a core and latency with lengths at 1 kHz"
RATE_HZ = 1000
DURATION_S = 10.0
GAIT = Gait(0.07, 0.2)
CAMERA_LENGTH_M = 0.2952


class Source:
    """Publisher of lengths stamped with the time of publication, and subscriber to the states."""

    def __init__(self, topic: str) -> None:
        self.node = rclpy.create_node("load", namespace="/worm")
        self._topic = topic
        self._lengths = self.node.create_publisher(BodyLength, f"body_length/{topic}", 1000)
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._gait = self.node.create_publisher(GaitState, "gait_state", latched)
        self._states = self.node.create_subscription(TwinState, "twin/state", lambda _: None, 1000)
        self.latencies: list[float] = []

    def ready(self) -> bool:
        """True if the twin is in the graph."""
        connected = self._lengths.get_subscription_count() and self._gait.get_subscription_count()
        return bool(connected)

    def begin(self) -> int:
        """Begin a gait now and return the stamp of its onset in ns."""
        onset = time.time_ns()
        message = GaitState(state=GaitState.RUNNING)
        message.gait = GaitMessage(stroke=GAIT.stroke, frequency=GAIT.frequency, direction=1)
        for stamp in (message.header.stamp, message.onset):
            stamp.sec, stamp.nanosec = divmod(onset, 10**9)
        self._gait.publish(message)
        return onset

    def send(self, onset: int) -> None:
        """Publish one length, stamped now."""
        now = time.time_ns()
        change = GAIT.command((now - onset) * 1e-9)
        message = BodyLength(length=CAMERA_LENGTH_M + 0.8 * change, length_change=change)
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(now, 10**9)
        self._lengths.publish(message)

    def listen(self) -> None:
        """Process the states that have arrived."""
        handle: Any = self._states.handle
        with handle:
            while (taken := handle.take_message(TwinState, False)) is not None:
                stamp = taken[0].header.stamp
                self.latencies.append((time.time_ns() - stamp.sec * 10**9 - stamp.nanosec) * 1e-9)


def processor_time(pid: int) -> float:
    """Return the processor time of a process, s."""
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


@dataclass(frozen=True)
class Load:
    """Share of a core, and latencies of the states in s."""

    share: float
    latencies: np.ndarray


def measure(topic: str) -> Load:
    """Measure the twin with lengths on a topic."""
    with tempfile.TemporaryDirectory() as folder, ProcessGroup(Path(folder)) as group:
        command = [*executable_command("worm_model", "twin_node"), "--ros-args"]
        process = group.start("twin", [*command, "-r", "__ns:=/worm"])
        source = Source(topic)
        if not wait_for(source.ready, 120.0):
            raise RuntimeError(f"the twin did not start: {process.last_line()}")
        freeze_garbage_collection()  # of the source, which would pass for the twin's
        onset = source.begin()
        started, used = time.monotonic(), processor_time(process.pid)
        sent = 0
        while (elapsed := time.monotonic() - started) < DURATION_S:
            while sent < elapsed * RATE_HZ:
                source.send(onset)
                sent += 1
            source.listen()
            time.sleep(0.0003)
        share = (processor_time(process.pid) - used) / DURATION_S
        source.node.destroy_node()
        return Load(share, np.array(source.latencies))


def run() -> list[Row]:
    """Measure with both kinds of length."""
    os.environ.setdefault("ROS_DOMAIN_ID", "69")
    rclpy.init()
    rows = []
    try:
        for topic in ("commanded", "measured"):
            load = measure(topic)
            share, latency = load.share, load.latencies
            p50, p99 = np.percentile(latency, [50, 99]) * 1e3
            how = f"{len(latency)} states of {int(RATE_HZ * DURATION_S)} lengths"
            rows.append(Row(f"core, {topic}", f"{100 * share:.1f} %", "< 7 %", how))
            rows.append(Row(f"latency, {topic}", f"p99 {p99:.2f} ms", "-", f"median {p50:.2f} ms"))
    finally:
        rclpy.try_shutdown()
    return rows


if __name__ == "__main__":
    from benchmarks.report import print_rows

    print_rows(TITLE, run())
