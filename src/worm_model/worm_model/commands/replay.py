# SPDX-License-Identifier: Apache-2.0
"""Command line: replay of a bag with the twin, faster than real time."""

from __future__ import annotations

import argparse
import time
from bisect import bisect_left
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from worm_model.bags.formats.bag_errors import BagError
from worm_model.bags.formats.message_block import Message, Topic
from worm_model.bags.formats.message_types import parse_ahead, topic_of
from worm_model.bags.opening import Bag, open_bag
from worm_model.bags.operations.copies import write_copy
from worm_model.bags.recording.run_manifest import recorded_conditions
from worm_model.bags.run_reader import clock_offset, namespace_of, read_parts
from worm_model.bags.run_writer import stamped_messages
from worm_model.bags.worm_topics import (
    REPLAY_INPUTS,
    TWIN_TOPICS,
    TYPES,
    find_topic,
    offered_qos,
)
from worm_model.commands.command_line import (
    Parser,
    executable,
    new_file,
    notifier,
    print_result,
)
from worm_model.loads import under
from worm_model.parameters import load_parameters
from worm_model.run import LengthSource, Stamps
from worm_model.text_table import labelled, text_table
from worm_model.twin.data.records import NANOSECONDS, RESIDUAL_FIELDS, Event, residual_message

if TYPE_CHECKING:
    from worm_model.analysis.replay_metrics import CycleReport, ReplayReport, RunReport
    from worm_model.twin.offline_replay import OfflineReplay
    from worm_model.twin.twin import Output

# The twin requires at least one of these topics.
DRIVES = ("body_length/commanded", "body_length/measured")
# ns; longest time by which an event can be older than states that the twin returned before it
DISORDER_NS = 10 * NANOSECONDS
_notify = notifier("replay")


def write_replay(bag: Bag, output: Path, replay: OfflineReplay, namespace: str) -> None:
    """Write a bag with the original messages and the twin's messages; equal replays produce equal bytes.

    The twin's messages replace those of the same topics in the original bag. The log time of such a message is its
    stamp plus the offset between log times and stamps in the original bag (`run_reader.clock_offset`).
    """
    found = (find_topic(bag.channels, name, namespace) for name in TWIN_TOPICS)
    live = {topic.name for topic in found if topic is not None}
    kept = [channel for channel in bag.channels if channel.name not in live]
    topics = {
        name: topic_of(f"{namespace}/{name}", TYPES[name], offered_qos(name))
        for name in TWIN_TOPICS
    }
    shift_ns = clock_offset(bag, namespace)
    messages = _in_order(
        [m for name in TWIN_TOPICS for m in _messages(name, topics[name], part, shift_ns)]
        for _, part in replay.steps()
    )
    own = bag.messages({channel.name for channel in kept})
    write_copy(bag, output, [own, messages], [*kept, *topics.values()])


def _in_order(batches: Iterable[list[Message]]) -> Iterator[Message]:
    """Yield the messages of batches in order of log time.

    No message may be more than DISORDER_NS older than a message of an earlier batch.
    """
    waiting: list[Message] = []
    for batch in batches:
        waiting = sorted([*waiting, *batch], key=attrgetter("log_time"))
        newest = waiting[-1].log_time if waiting else 0
        ready = bisect_left(waiting, newest - DISORDER_NS, key=attrgetter("log_time"))
        yield from waiting[:ready]
        del waiting[:ready]
    yield from waiting


def _messages(name: str, topic: Topic, output: Output, shift_ns: int) -> list[Message]:
    """Return the messages of one of the twin's topics; their log time is their stamp plus ``shift_ns``."""
    stamp, numbers, texts = twin_columns(name, output)
    return [
        m._replace(log_time=m.log_time + shift_ns, publish_time=m.publish_time + shift_ns)
        for m in stamped_messages(topic, stamp, numbers, texts)
    ]


def twin_columns(
    name: str, output: Output
) -> tuple[Stamps, dict[str, Any], dict[str, Sequence[str]]]:
    """Return the content of the messages of one of the twin's topics: stamps (ns), numbers and texts.

    Numbers and texts contain one entry for each field of the message: an array, a list, or a constant.
    """
    if name == "twin/events":
        events = output.events
        numbers: dict[str, Any] = {
            key: np.array([getattr(event, key) for event in events], kind)
            for key, kind in (("run", np.int64), ("cycle", np.int64), ("probability", float))
        }
        texts: dict[str, Sequence[str]] = {
            "code": [event.code for event in events],
            "message": [event.text for event in events],
        }
        return np.array([event.stamp_ns for event in events], np.int64), numbers, texts
    series: np.ndarray = {
        "twin/state": output.states,
        "twin/residuals": output.residuals,
        "body_length/estimated": output.lengths,
    }[name]
    fields = series.dtype.names or ()
    kept = RESIDUAL_FIELDS if name == "twin/residuals" else fields[1:]  # without the stamp
    numbers = {key: np.ascontiguousarray(series[key]) for key in kept}
    if name == "body_length/estimated":
        numbers["source"] = LengthSource.ESTIMATED
    return (
        np.ascontiguousarray(series["stamp_ns"]),
        numbers,
        {"message": [residual_message(row, output.warnings) for row in series]}
        if name == "twin/residuals"
        else {},
    )


def report_json(
    report: ReplayReport, dropped: Mapping[str, int], duration: float, elapsed: float
) -> dict[str, Any]:
    """Return the report in machine-readable form.

    ``dropped`` is the number of excluded samples by reason, ``duration`` that of the bag (s), and ``elapsed`` that of
    the replay (s).
    """
    return {
        **asdict(report.residuals),
        "energy_error": report.energy_error,
        "cycles": [_cycle_json(cycle) for cycle in report.cycles],
        "runs": [_run_json(run) for run in report.runs],
        "events": [_event_json(*event) for run in report.runs for event in run.events],
        "dropped": dropped,
        "duration": duration,
        "real_time_factor": duration / elapsed,
    }


def _run_json(run: RunReport) -> dict[str, Any]:
    return {
        "onset_s": run.onset,
        "run": run.played.run,
        "gait": asdict(run.played.gait),
        "cycles": [_cycle_json(cycle) for cycle in run.cycles],
        "events": [_event_json(*event) for event in run.events],
        "health": run.health.name.lower(),
        "not_judged": run.not_judged,
    }


def _event_json(time: float, event: Event) -> dict[str, Any]:
    return {
        "time_s": time,
        "cycle": event.cycle,
        "code": event.code,
        "probability": event.probability,
        "message": event.text,
    }


def _cycle_json(cycle: CycleReport) -> dict[str, Any]:
    content = asdict(cycle)
    residuals = content.pop("residuals")
    return {**content, **residuals}


def describe(
    report: ReplayReport, dropped: Mapping[str, int], duration: float, elapsed: float
) -> str:
    """Return the report as text; for the arguments see `report_json`."""
    total = report.residuals
    whole = {
        "x1": f"{1e3 * total.x1_rmse:.3f} mm rms, {1e3 * total.x1_residual:+.3f} mm mean",
        "length": f"{1e3 * total.length_rmse:.3f} mm rms, {1e3 * total.length_residual:+.3f} mm mean",
        "power": f"{total.power_rmse:.3f} W rms, {total.power_residual:+.3f} W mean",
        "energy": f"{100 * report.energy_error:+.2f} % of the measured energy",
    }
    lines = [labelled(whole)]
    if any("nan" in text for text in whole.values()):
        lines.append("nan: not compared, because it was not recorded during a gait")
    for number, run in enumerate(report.runs, 1):
        gait = run.played.gait
        health = run.not_judged or f"{run.health.name.lower()} at worst"
        lines.append(
            f"run {number} of {len(report.runs)}: {1e3 * gait.stroke:.1f} mm at {gait.frequency:.3f} Hz "
            f"{'forward' if gait.direction > 0 else 'reverse'}, {'not judged: ' if run.not_judged else ''}{health}"
        )
        events = [event for _, event in run.events]
        rows = [_cycle_row(cycle, events) for cycle in run.cycles]
        lines.append(text_table([_CYCLE_HEADS, *rows]))
        lines += [f"  {time:.2f} s  {event.text}" for time, event in run.events]
    if dropped:
        why = ", ".join(f"{count} {name}" for name, count in dropped.items())
        lines.append(f"samples not used: {why}")
    lines.append(f"{duration:.1f} s in {elapsed:.3f} s: {duration / elapsed:.0f} times real time")
    return "\n".join(lines)


_CYCLE_HEADS = (
    *("cycle", "start s", "grooves", "measured"),
    *("x1 mm rms", "length mm rms", "power W rms", "events"),
)


def _cycle_row(cycle: CycleReport, events: Sequence[Event]) -> tuple[str, ...]:
    rms = cycle.residuals
    remarks = [e.code.replace("_", " ") for e in events if e.cycle == cycle.number]
    if cycle.not_judged:
        remarks.insert(0, f"not judged: {cycle.not_judged}")
    return (
        str(cycle.number),
        f"{cycle.start:.2f}",
        f"{cycle.grooves:.0f}",
        f"{cycle.measured_grooves:.2f}",
        f"{1e3 * rms.x1_rmse:.2f}",
        f"{1e3 * rms.length_rmse:.2f}",
        f"{rms.power_rmse:.2f}",
        ", ".join(remarks),
    )


def _parser() -> Parser:
    parser = Parser(
        prog="replay",
        description="Run the twin on the samples of a bag, and report the residuals (measured minus predicted).",
    )
    parser.add_argument("bag", type=Path, metavar="BAG")
    parser.add_argument(
        "--output", metavar="BAG2", help="new bag with the original topics and the twin's"
    )
    parser.add_argument(
        "--namespace", default="", help="namespace of the robot; default: the only one in the bag"
    )
    parser.add_json()
    parser.add_parameters()
    return parser


def _replay(options: argparse.Namespace) -> None:
    from worm_model.analysis.replay_metrics import ReplayReporter  # here: Numba loads slowly
    from worm_model.twin import warm_up
    from worm_model.twin.offline_replay import OfflineReplay

    parameters = load_parameters(options.parameters)
    output = new_file(options.output) if options.output else None
    warm_up.main()  # so that the time below includes neither compilation nor parsing of definitions
    parse_ahead(TYPES[name] for name in (*REPLAY_INPUTS, *TWIN_TOPICS))
    begin = time.perf_counter()
    with open_bag(options.bag, _notify) as bag:
        parts = read_parts(bag, options.namespace, REPLAY_INPUTS)
        _check_drive(bag, options.namespace)
        parameters = under(recorded_conditions(bag), parameters)
        replay = OfflineReplay(lambda: parts, parameters)
        reporter = replay.feed(lambda: ReplayReporter(replay.samples, parameters.pitch))
        report = reporter.report(replay.unusable)
        for event in reporter.events:
            _notify(event.text)
        if output is not None:
            write_replay(bag, output, replay, options.namespace or namespace_of(bag))
        duration = bag.duration_s
    elapsed = time.perf_counter() - begin
    print_result(
        options,
        report_json(report, replay.dropped, duration, elapsed),
        describe(report, replay.dropped, duration, elapsed),
    )


def _check_drive(bag: Bag, namespace: str) -> None:
    """Raise BagError if a bag contains neither commanded nor measured lengths; the twin requires one of them."""
    topics = [find_topic(bag.channels, name, namespace) for name in DRIVES]
    if not any(topic is not None and topic.count for topic in topics):
        raise BagError(
            f"{bag.path} contains neither body_length/commanded nor body_length/measured, one of which the twin "
            "requires; record both, and gait_state"
        )


main = executable(_parser, _replay)
