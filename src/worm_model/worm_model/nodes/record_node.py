# SPDX-License-Identifier: Apache-2.0
"""``worm_model record``: subscribes raw to any topics and writes them to a bag."""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NoReturn

from rclpy.utilities import remove_ros_args

from worm_model.bags.recorder import COMPRESSIONS, BagRecorder, Options, RecorderError
from worm_model.bags.recording_thread import RecordingThread, Sample, Tally
from worm_model.bags.run_manifest import ManifestError, run_manifest
from worm_model.bags.topic_selection import SelectionError, TopicSelection
from worm_model.nodes.raw_subscriptions import RecordNode
from worm_msgs.ros_process import ros_process

POLL_S = 0.01
DISCOVERY_S = 0.1
REPORT_S = 0.5
BACKLOG_BYTES = 100 * 2**20  # rosbag2's cache


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="record", description="Records topics to a rosbag2 bag (MCAP)."
    )
    parser.add_argument("topics", nargs="*", metavar="TOPIC", help="topics to record")
    parser.add_argument(
        "-o", "--output", type=Path, help="the bag, a directory that must not exist"
    )
    parser.add_argument("-a", "--all", action="store_true", help="all topics that are not hidden")
    parser.add_argument("-e", "--regex", default="", help="topics whose full name matches")
    parser.add_argument(
        "-x", "--exclude", default="", metavar="REGEX", help="what --all and --regex leave out"
    )
    parser.add_argument(
        "--include-hidden-topics", action="store_true", help="also such as an action's feedback"
    )
    parser.add_argument(
        "-p",
        "--parameters",
        type=Path,
        metavar="FILE",
        help="parameter file of the run, kept inside",
    )
    parser.add_argument("--seed", type=int, help="seed of the run")
    parser.add_argument(
        "--note", action="append", default=[], metavar="KEY=VALUE", help="a line for the manifest"
    )
    parser.add_argument(
        "--compression", choices=COMPRESSIONS, default="zstd", help="of chunks (default: zstd)"
    )
    parser.add_argument(
        "-b", "--max-bag-size", type=int, default=0, metavar="BYTES", help="split at this size"
    )
    parser.add_argument(
        "-d",
        "--max-bag-duration",
        type=float,
        default=0.0,
        metavar="S",
        help="split after this time",
    )
    parser.add_argument(
        "--duration", type=float, default=0.0, metavar="S", help="stop by itself after this time"
    )
    parser.add_argument(
        "--depth", type=int, default=1000, help="messages of a topic that may wait (default: 1000)"
    )
    parser.add_argument("--json", action="store_true", help="print the outcome as one JSON object")
    return parser


class _Progress:
    """Totals of a recording and its live line on standard error."""

    def __init__(self, node: RecordNode, thread: RecordingThread) -> None:
        self._node = node
        self._thread = thread
        self._start = time.monotonic()
        self._received = Tally()

    @property
    def elapsed(self) -> float:
        """Seconds since the start."""
        return time.monotonic() - self._start

    def count(self, samples: Sequence[Sample]) -> None:
        """Add what was received."""
        self._received.add(samples)

    def totals(self) -> dict[str, int | float]:
        """The outcome so far: dropped are those lost on the way and those that the disk could not take."""
        dropped = self._thread.dropped
        return {
            "messages": self._received.messages - dropped.messages,
            "bytes": self._received.bytes - dropped.bytes,
            "dropped": self._node.lost + dropped.messages,
            "topics": self._node.topic_count,
            "duration": round(self.elapsed, 3),
        }

    def show(self, end: str) -> None:
        """Write the live line."""
        totals = self.totals()
        line = "{duration:8.1f} s  {topics} topics  {messages} messages  {mb:.2f} MB  {dropped} dropped"
        sys.stderr.write(line.format(mb=totals["bytes"] / 1e6, **totals) + end)
        sys.stderr.flush()


def _record(
    node: RecordNode, thread: RecordingThread, ended: Callable[[], bool], duration: float
) -> _Progress:
    """Take messages until told to stop, the time is over or the disk fails."""
    progress = _Progress(node, thread)
    live = sys.stderr.isatty()
    discovery = report = time.monotonic()
    while not ended() and thread.error is None and not 0.0 < duration <= progress.elapsed:
        now = time.monotonic()
        if now >= discovery:
            node.discover()
            discovery = now + DISCOVERY_S
        _hand_over(node, thread, progress)
        if live and now >= report:
            progress.show("\r")
            report = now + REPORT_S
        time.sleep(POLL_S)
    _hand_over(node, thread, progress)
    return progress


def _hand_over(node: RecordNode, thread: RecordingThread, progress: _Progress) -> None:
    samples = node.take()
    if not samples:
        return
    progress.count(samples)
    thread.offer(samples)
    gait = node.new_gait(samples)
    if gait is not None:
        thread.note(gait)


def _fail(status: int, message: str) -> NoReturn:
    sys.stderr.write(f"record: {message}\n")
    raise SystemExit(status)


def _run(arguments: argparse.Namespace, command: Sequence[str], ended: Callable[[], bool]) -> int:
    now = time.time_ns()
    output = arguments.output or Path(
        time.strftime("worm_%Y_%m_%d-%H_%M_%S", time.localtime(now / 1e9))
    )
    options = Options(
        arguments.compression,
        split_bytes=arguments.max_bag_size,
        split_s=arguments.max_bag_duration,
    )
    selection = TopicSelection(
        frozenset(arguments.topics),
        everything=arguments.all,
        regex=arguments.regex,
        exclude=arguments.exclude,
        hidden=arguments.include_hidden_topics,
    )
    manifest = run_manifest(arguments.parameters, arguments.seed, arguments.note, command, now)
    node = RecordNode(selection, arguments.depth)
    recorder = BagRecorder(output, manifest, options, now)
    thread = RecordingThread(recorder, options.sync_s, BACKLOG_BYTES)
    node.get_logger().info(f"recording to {output}")
    try:
        progress = _record(node, thread, ended, arguments.duration)
    finally:
        thread.close()
    progress.show("\n")
    for name in node.missing:
        sys.stderr.write(f"record: {name} was never published\n")
    if arguments.json:
        sys.stdout.write(
            json.dumps({"bag": str(output), **progress.totals(), "missing": node.missing}) + "\n"
        )
    if thread.error is not None:
        _fail(
            1,
            f"{output} could not be written: {thread.error}; what was written is kept, see recover",
        )
    return 0


def main() -> None:
    """Entry point of ``ros2 run worm_model record``."""
    try:
        command = remove_ros_args(sys.argv)
        arguments = _parser().parse_args(command[1:])
        with ros_process() as ended:
            raise SystemExit(_run(arguments, command, ended))
    except (RecorderError, SelectionError, ManifestError) as error:
        _fail(2, str(error))
    except OSError as error:
        _fail(1, f"{error.filename or 'the bag'} cannot be written: {error.strerror}")
