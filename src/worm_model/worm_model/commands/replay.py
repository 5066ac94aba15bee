# SPDX-License-Identifier: Apache-2.0
"""Command line: offline replay of a bag through the twin."""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from worm_model.analysis.replay_metrics import (
    CycleReport,
    ReplayReport,
    RunReport,
    report_replay,
)
from worm_model.bags.bag import Bag
from worm_model.bags.bag_errors import BagError
from worm_model.bags.formats.message_block import Message
from worm_model.bags.formats.message_types import parse_ahead, topic_of
from worm_model.bags.opening import open_bag
from worm_model.bags.run_reader import namespace_of, read_run
from worm_model.bags.run_writer import stamped_messages, write_beside
from worm_model.bags.worm_topics import (
    REPLAY_INPUTS,
    SERIES,
    TWIN_INPUTS,
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
from worm_model.parameters import Parameters, load_parameters
from worm_model.run import Run, Stamps
from worm_model.simulation import warm_up
from worm_model.twin.offline_replay import Replay, Series, replay_run
from worm_model.twin.records import NANOSECONDS, RESIDUAL_FIELDS, Event, LengthSource
from worm_model.twin.samples import Kind

LONGEST_DELAY_NS = NANOSECONDS  # of a message on its way to the recorder
_notify = notifier("replay")


def write_replay(bag: Bag, output: Path, replay: Replay, namespace: str, shift_ns: int = 0) -> None:
    """Write a bag with the messages of the original and of the twin; the same replay gives the same bytes.

    What a live twin had published into the original bag is left out: the twin's topics are this replay's.
    ``shift_ns`` is by how much the bag's log time is ahead of its stamps: the twin's lie where the originals do.

    Raises:
        BagError: the output exists or cannot be written.
    """
    live = {find_topic(bag.topics.values(), name, namespace) for name in TWIN_TOPICS}
    kept = [topic.name for topic in bag.topics.values() if topic not in live]
    messages = [_messages(name, replay, namespace, shift_ns) for name in TWIN_TOPICS]
    write_beside(bag, output, kept, messages)


def received(bag: Bag, namespace: str, run: Run) -> dict[int, Stamps]:
    """Return the log times (ns) of a run's samples by kind, without kinds with excluded messages."""
    topics = [find_topic(bag.topics.values(), name, namespace) for name in TWIN_INPUTS]
    names = {topic.name: Kind(k) for k, topic in enumerate(topics) if topic is not None}
    stamps: dict[int, list[Stamps]] = {kind: [] for kind in names.values()}
    for block in bag.blocks(names):
        for name, messages in block.by_topic():
            stamps[names[name]].append(messages.log_time.astype(np.int64))
    times = {kind: np.concatenate(parts) for kind, parts in stamps.items() if parts}
    samples = _by_kind(run)
    return {kind: t for kind, t in times.items() if len(t) == len(samples[kind].stamp)}


def shift_of(run: Run, times: Mapping[int, Stamps]) -> int:
    """Return the offset of log times ahead of the stamps in ns; 0 below one second, which is delay."""
    samples = _by_kind(run)
    ahead = [times[kind] - samples[kind].stamp for kind in times if kind != Kind.GAIT]
    shift = int(np.median(np.concatenate(ahead))) if ahead else 0
    return shift if abs(shift) > LONGEST_DELAY_NS else 0


def _by_kind(run: Run) -> dict[int, Any]:
    """Return the run's samples of the twin's inputs."""
    return dict(zip(Kind, (getattr(run, SERIES[name][0]) for name in TWIN_INPUTS), strict=True))


def _messages(name: str, replay: Replay, namespace: str, shift_ns: int) -> list[Message]:
    """Return the messages of one of the twin's topics; the log time is the stamp plus a shift."""
    topic = topic_of(f"{namespace}/{name}", TYPES[name], offered_qos(name))
    stamp, numbers, texts = twin_columns(name, replay)
    messages = stamped_messages(topic, stamp, numbers, texts)
    if not shift_ns:
        return messages
    return [
        m._replace(log_time=m.log_time + shift_ns, publish_time=m.publish_time + shift_ns)
        for m in messages
    ]


def twin_columns(
    name: str, replay: Replay
) -> tuple[Stamps, dict[str, Any], dict[str, Sequence[str]]]:
    """Return stamps in ns, numbers and texts of one of the twin's topics, one column per field."""
    if name == "twin/events":
        notices = replay.notices
        numbers: dict[str, Any] = {
            key: np.array([getattr(notice, key) for notice in notices], kind)
            for key, kind in (("run", np.int64), ("cycle", np.int64), ("probability", float))
        }
        texts: dict[str, Sequence[str]] = {
            "code": [n.code for n in notices],
            "message": [n.text for n in notices],
        }
        return np.array([n.stamp_ns for n in notices], np.int64), numbers, texts
    series: Series = {
        "twin/state": replay.states,
        "twin/residuals": replay.residuals,
        "body_length/estimated": replay.lengths,
    }[name]
    kept = RESIDUAL_FIELDS if name == "twin/residuals" else list(series)[1:]  # but for the stamp
    numbers = {key: series[key] for key in kept}
    if name == "body_length/estimated":
        numbers["source"] = LengthSource.ESTIMATED
    return (
        series["stamp_ns"],
        numbers,
        {"message": replay.messages} if name == "twin/residuals" else {},
    )


def report_json(
    report: ReplayReport, replay: Replay, duration: float, elapsed: float
) -> dict[str, Any]:
    """Return the report for the machine-readable output."""
    return {
        **asdict(report.residuals),
        "energy_error": report.energy_error,
        "cycles": [_cycle_json(cycle) for cycle in report.cycles],
        "runs": [_run_json(run) for run in report.runs],
        "events": [_event_json(*event) for run in report.runs for event in run.events],
        "dropped": replay.dropped or {},
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
    return {
        "number": cycle.number,
        "start": cycle.start,
        "grooves": cycle.grooves,
        "measured_grooves": cycle.measured_grooves,
        "complete": cycle.complete,
        "not_judged": cycle.not_judged,
        **asdict(cycle.residuals),
    }


def describe(
    report: ReplayReport, dropped: Mapping[str, int], duration: float, elapsed: float
) -> str:
    """Return the report as text; ``dropped`` has the number of samples by reason."""
    lines = _total_lines(report)
    for number, run in enumerate(report.runs, 1):
        gait = run.played.gait
        lines.append(
            f"run {number} of {len(report.runs)}: {1e3 * gait.stroke:.1f} mm at {gait.frequency:.3f} Hz "
            f"{'forward' if gait.direction > 0 else 'reverse'}, {_health(run)}"
        )
        lines.append("cycle  start s  grooves (measured)  x1 mm   length mm  power W  (rms)")
        events = [event for _, event in run.events]
        lines += [_cycle_line(cycle, events) for cycle in run.cycles]
        lines += [f"  {time:.2f} s  {event.text}" for time, event in run.events]
    if dropped:
        why = ", ".join(f"{count} {name}" for name, count in dropped.items())
        lines.append(f"samples not taken: {why}")
    lines.append(f"{duration:.1f} s in {elapsed:.3f} s: {duration / elapsed:.0f} times real time")
    return "\n".join(lines)


def _total_lines(report: ReplayReport) -> list[str]:
    """Return the residuals of the whole recording, or the reason why there are none."""
    total = report.residuals
    energy = 100 * report.energy_error
    rows = (
        ("x1", total.x1_rmse, "{:8.3f} mm rms, {:+.3f} mm mean", 1e3, total.x1_residual),
        (
            "length",
            total.length_rmse,
            "{:8.3f} mm rms, {:+.3f} mm mean",
            1e3,
            total.length_residual,
        ),
        ("power", total.power_rmse, "{:8.3f} W  rms, {:+.3f} W  mean", 1.0, total.power_residual),
        ("energy", energy, "{:+8.2f} % of what was measured", 1.0, math.nan),
    )
    return [
        f"{name:6}  "
        + (
            text.format(scale * value, scale * mean)
            if math.isfinite(value)
            else f"not compared: {_SOURCES[name]} during the gait"
        )
        for name, value, text, scale, mean in rows
    ]


_SOURCES = {
    "x1": "no position of the tracker was recorded",
    "length": "no measured length was recorded",
    "power": "no power was recorded",
    "energy": "no power was recorded",
}


def _health(run: RunReport) -> str:
    return (
        f"not judged: {run.not_judged}" if run.not_judged else f"{run.health.name.lower()} at worst"
    )


def _cycle_line(cycle: CycleReport, events: Sequence[Event]) -> str:
    part = cycle.residuals
    codes = ", ".join(e.code.replace("_", " ") for e in events if e.cycle == cycle.number)
    return (
        f"{cycle.number:5}  {cycle.start:7.2f}  {cycle.grooves:7.0f} ({cycle.measured_grooves:8.2f})  "
        f"{1e3 * part.x1_rmse:6.2f}  {1e3 * part.length_rmse:9.2f}  {part.power_rmse:7.2f}"
        f"{f'  not judged: {cycle.not_judged}' if cycle.not_judged else ''}{f'  {codes}' if codes else ''}"
    )


def _parser() -> Parser:
    parser = Parser(
        prog="replay",
        description="Lets the twin follow a bag and reports how far it is from what was measured.",
    )
    parser.add_argument("bag", type=Path, metavar="BAG")
    parser.add_argument(
        "--output", metavar="BAG2", help="a new bag with the twin's topics beside the original ones"
    )
    parser.add_argument("--namespace", default="", help="of the robot; default: the one in the bag")
    parser.add_definitions()
    parser.add_json()
    parser.add_parameters()
    return parser


def _replay(options: argparse.Namespace) -> None:
    parameters = load_parameters(options.parameters)
    output = new_file(options.output) if options.output else None
    warm_up.main()  # neither compiling nor parsing definitions is replaying
    parse_ahead(TYPES[name] for name in (*REPLAY_INPUTS, *TWIN_TOPICS))
    begin = time.perf_counter()
    with open_bag(options.bag, _notify, options.definitions) as bag:
        run = read_run(bag, options.namespace, REPLAY_INPUTS)
        _check_drive(run, bag)
        followed = _follow(run, parameters, bag, output, options.namespace)
        duration = (bag.end - bag.start) * 1e-9
    report = report_replay(run, followed, parameters.pitch)
    elapsed = time.perf_counter() - begin
    print_result(
        options,
        report_json(report, followed, duration, elapsed),
        describe(report, followed.dropped or {}, duration, elapsed),
    )


def _check_drive(run: Run, bag: Bag) -> None:
    """Raise `BagError` if a bag has no length, which drives the twin."""
    if not (len(run.commanded.stamp) or len(run.measured.stamp)):
        raise BagError(
            f"{bag.path}: the twin cannot follow it: it has no body_length/commanded and no body_length/measured; "
            "record them, with gait_state"
        )


def _follow(
    run: Run, parameters: Parameters, bag: Bag, output: Path | None, namespace: str
) -> Replay:
    times = received(bag, namespace, run)
    replay = replay_run(run, parameters)
    for notice in replay.notices:
        _notify(notice.text)
    if output is not None:
        where = namespace or namespace_of(bag)
        write_replay(bag, output, replay, where, shift_of(run, times))
    return replay


main = executable(_parser, _replay)
