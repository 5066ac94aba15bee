# SPDX-License-Identifier: Apache-2.0
"""``worm_model record``: recording of any topics to a bag, through raw subscriptions."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

from worm_model.bags.formats.bag_errors import BagError, UnwritableError
from worm_model.bags.formats.finding import TIME_FIELD, dated
from worm_model.bags.recording.recorder import Manifest
from worm_model.bags.recording.recording_session import RecordingSession, after_crash
from worm_model.bags.recording.run_manifest import is_text, run_manifest
from worm_model.commands import command_line
from worm_model.nodes.raw_subscriptions import RecordNode
from worm_msgs.conditions import conditions_of
from worm_msgs.ros_process import ShutdownRequest, own_arguments, ros_process

POLL_S = 0.01  # time between two polls of the subscriptions
DISCOVERY_S = 0.1  # time between two searches for new topics, and between two polls of the services
REPORT_S = 0.5  # time between two updates of the live line


def _parser() -> command_line.Parser:
    parser = command_line.Parser(
        prog="record",
        description="Record topics to a rosbag2 bag (MCAP) until Ctrl-C or another signal. Messages are written to the "
        "disk twice a second.",
    )
    parser.add_argument(
        "topics",
        nargs="*",
        metavar="TOPIC",
        help="topics to record (default: all topics of the node's namespace and /diagnostics, except images)",
    )
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        default=Path(f"worm_{TIME_FIELD}"),
        help=f"the bag, a directory that must not exist; {TIME_FIELD} is replaced by the time at which it begins "
        "(default: %(default)s)",
    )
    parser.add_argument(
        "-p",
        "--parameters",
        type=Path,
        metavar="FILE",
        help="parameter file of the run, stored in the bag",
    )
    parser.add_conditions()
    parser.add_argument("--seed", type=int, help="seed of the run")
    parser.add_argument(
        "--note",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="entry for the bag's metadata; may be repeated",
    )
    parser.add_argument(
        "--snapshot",
        type=command_line.not_negative,
        default=0.0,
        metavar="S",
        help="store only the last S seconds, in memory; write them to OUTPUT_snapshot_1 and so on when ~/snapshot "
        "(std_srvs/Trigger) is called or the twin raises an alarm (an event with a code on twin/events, which must be "
        "among the topics)",
    )
    parser.add_argument(
        "--to-rest",
        action="store_true",
        help="after Ctrl-C, continue until the driver has released the robot's torque or has ended; a second Ctrl-C "
        "ends the recording at once",
    )
    parser.add_argument(
        "--after-crash",
        action="store_true",
        help="if OUTPUT is a bag that its recorder has not closed, record to OUTPUT_2, OUTPUT_3 and so on: for a "
        "recorder that is restarted after a crash",
    )
    parser.add_argument("--json", action="store_true", help="print the outcome as one JSON object")
    return parser


class _Recorder:
    """Recorder node and session, with their totals as a live line on standard error."""

    def __init__(self, node: RecordNode, session: RecordingSession) -> None:
        self._node = node
        self._session = session
        self._start = time.monotonic()
        self._end_at_once = False

    @property
    def elapsed(self) -> float:
        """Seconds since the start."""
        return time.monotonic() - self._start

    def request_immediate_end(self) -> None:
        """End the recording without waiting for the driver. Safe in a signal handler."""
        self._end_at_once = True

    def to_rest(self, ended: Callable[[], bool]) -> bool:
        """Return True if the end is requested, and either the driver has released the robot or the end is immediate.

        The end is immediate after a second request. With --to-rest, `run` uses this function instead of ``ended``.
        """
        if not ended():
            return False
        self.take()  # The driver may have published its state since the last poll.
        return self._end_at_once or not self._node.awaits_rest

    def run(self, ended: Callable[[], bool]) -> None:
        """Record messages until the end is requested, or writing fails."""
        live = sys.stderr.isatty()
        discovery = report = time.monotonic()
        while not (ended() or self._session.error):
            now = time.monotonic()
            if now >= discovery:
                self._node.discover()
                self._session.add_topics(self._node.topics)
                self._node.serve()
                discovery = now + DISCOVERY_S
            self.take()
            if live and now >= report:
                self.show("\r")
                report = now + REPORT_S
            time.sleep(POLL_S)
        self.take()

    def take(self) -> None:
        """Pass received messages on to the session."""
        messages = self._node.take()
        self._session.offer(messages)
        alarm = self._node.observe(messages)
        if alarm and self._session.ring_s:
            try:
                outcome = self._session.snapshot()
            except (BagError, OSError) as error:  # The next snapshot may succeed.
                outcome = f"no snapshot: {error}"
            self._node.get_logger().warning(f"the twin raises an alarm ({alarm}): {outcome}")

    def totals(self) -> dict[str, int | float]:
        """Return the totals so far; ``dropped`` counts the messages that were lost in transit."""
        return {
            "messages": self._session.messages,
            "bytes": self._session.bytes,
            "dropped": self._node.lost,
            "topics": len(self._node.topics),
            "duration": round(self.elapsed, 3),
        }

    def show(self, end: str) -> None:
        """Write the live line."""
        totals = self.totals()
        line = "{duration:8.1f} s  {topics} topics  {messages} messages  {mb:.2f} MB  {dropped} dropped"
        sys.stderr.write(line.format(mb=totals["bytes"] / 1e6, **totals) + end)
        sys.stderr.flush()


def _session(arguments: argparse.Namespace, command: Sequence[str]) -> RecordingSession:
    def manifest() -> Manifest:
        return run_manifest(
            arguments.parameters,
            arguments.seed,
            arguments.note,
            command,
            time.time_ns(),
            conditions_of(arguments),
        )

    manifest()  # An invalid note or file raises its error before a bag is created.
    output = dated(arguments.output)
    output = after_crash(output) if arguments.after_crash else output
    return RecordingSession(output, manifest, arguments.snapshot)


def _run(arguments: argparse.Namespace, command: Sequence[str], ended: ShutdownRequest) -> int:
    node = RecordNode(arguments.topics)
    session = _session(arguments, command)
    node.offer_service("snapshot", session.snapshot)
    what = f"the last {session.ring_s:g} s, for snapshots named after" if session.ring_s else "to"
    node.get_logger().info(f"recording {what} {session.output}")
    recording = _Recorder(node, session)
    ended.again = recording.request_immediate_end
    try:
        recording.run(partial(recording.to_rest, ended) if arguments.to_rest else ended)
    finally:
        session.close()
    return _report(recording, node, session, arguments)


def _report(
    recording: _Recorder,
    node: RecordNode,
    session: RecordingSession,
    arguments: argparse.Namespace,
) -> int:
    recording.show("\n")
    notify = command_line.notifier("record")
    for name, reason in node.missing.items():
        notify(f"{name} is not recorded: {reason}")
    if arguments.json:
        outcome = {
            "bag": str(session.output),
            "bags": [str(bag) for bag in session.bags],
            **recording.totals(),
            "missing": list(node.missing),
        }
        command_line.print_json(outcome)
    error = session.error
    if error is not None:
        notify(
            f"{session.output} could not be written: {error}. All commands read what is on the disk"
        )
    return command_line.DONE if error is None else command_line.FAILED


def _record(options: argparse.Namespace) -> int:
    try:
        with ros_process() as ended:
            return _run(options, own_arguments(sys.argv), ended)
    except OSError as error:
        what = error.filename or "the bag"
        raise UnwritableError(f"{what} cannot be written: {error.strerror}") from None


def main() -> int:
    """Entry point of ``ros2 run worm_model record``."""
    invalid = next((a for a in sys.argv if not is_text(a)), None)
    if invalid is not None:  # ROS could not parse it.
        command_line.notifier("record")(f"an argument is not UTF-8 text: {invalid!r}")
        return command_line.BAD_INPUT
    return command_line.run_command(_parser(), _record, own_arguments(sys.argv)[1:])
