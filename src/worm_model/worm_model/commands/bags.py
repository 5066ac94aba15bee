# SPDX-License-Identifier: Apache-2.0
"""Command line: table of the recorded runs, content of a bag, and a part of a bag, one verb each."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from worm_model.commands import command_line

if TYPE_CHECKING:
    from worm_model.bags.opening import Bag

TABLE = "table"
PARTS = "trim", "filter"
FOLDER = Path("bags")  # where ./worm records


def _parser() -> command_line.Parser:
    parser = command_line.Parser(
        prog="bags",
        description="Print a table of the recorded runs below a folder or the content of a bag, or copy a part of it. "
        "`bags FOLDER` means `bags table FOLDER`.",
    )
    verbs = parser.add_subparsers(
        dest="verb", required=True, metavar="VERB", parser_class=command_line.Parser
    )

    def add_verb(
        name: str, act: Callable[[argparse.Namespace], None], **texts: Any
    ) -> command_line.Parser:
        verb: command_line.Parser = verbs.add_parser(name, **texts)
        verb.set_defaults(act=act)
        verb.add_json()
        if name != TABLE:
            verb.add_argument("bag", type=Path, metavar="BAG")
        return verb

    table = add_verb(
        TABLE,
        _table,
        help="table of the recorded runs; the verb may be omitted",
        description="Print gait, cycles, groove phase, grooves per cycle, speed, power, cost of transport, health "
        "according to the twin, state of the files and notes of every run. An index stores the rows of bags that were "
        "read before.",
    )
    table.add_argument(
        "folder", type=Path, nargs="?", default=FOLDER, metavar="FOLDER", help="default: bags"
    )
    table.add_parameters("the file in each bag, else the paper's values")
    add_verb("info", _info, help="content of a bag")
    for name in PARTS:
        part = add_verb(
            name,
            _part,
            help="write a part of a bag, by time, by run or by topic",
            description="Write a bag with the messages of some topics in a span, or in one run and the time since the "
            "previous run.",
        )
        part.add_argument("--output", required=True, metavar="BAG2", help="must not exist")
        part.add_argument(
            "--topic", action="append", default=[], help="topic to copy; may be repeated"
        )
        part.add_number("--start", "S", "start of the span, in s since the start of the bag")
        part.add_number("--end", "S", "end of the span, in s since the start of the bag")
        part.add_argument(
            "--run", type=int, metavar="N", help="number of the run, from 1, instead of a span"
        )
    return parser


def _table(options: argparse.Namespace) -> None:
    from worm_model.commands.bag_runs import bag_rows, describe

    rows = bag_rows(options.folder, options.parameters, command_line.ProgressLine("bags"))
    command_line.print_result(options, {"runs": rows}, describe(rows, options.folder))


def _opened(options: argparse.Namespace) -> Bag:
    from worm_model.bags.opening import open_bag

    notify = command_line.notifier(f"bags {options.verb}")
    return open_bag(options.bag, notify)


def _info(options: argparse.Namespace) -> None:
    with _opened(options) as bag:
        content: dict[str, Any] = {
            "bag": str(bag.path),
            "start_ns": bag.start,
            "duration_s": bag.duration_s,
            "messages": bag.message_count,
            "topics": [
                {"name": topic.name, "type": topic.type_name, "messages": topic.count}
                for topic in bag.topics.values()
            ],
            "metadata": {
                name: record for name, record in bag.metadata.items() if name != "rosbag2"
            },
            "attachments": [attached.name for attached in bag.attachments()],
        }
    lines = [f"{content['bag']}: {content['messages']} messages in {content['duration_s']:.3f} s"]
    lines += [f"  {t['messages']:8}  {t['name']}  {t['type']}" for t in content["topics"]]
    for name, record in content["metadata"].items():
        lines += [f"  {name}.{key}: {value}" for key, value in record.items() if value]
    lines += [f"  attached: {name}" for name in content["attachments"]]
    command_line.print_result(options, content, "\n".join(lines))


def _part(options: argparse.Namespace) -> None:
    from worm_model.bags.operations.copies import write_part

    has_span = options.start is not None or options.end is not None
    if (options.run is not None) + has_span > 1 or not (
        options.run is not None or has_span or options.topic
    ):
        raise command_line.InputError(
            "give a span (--start, --end or both) or --run, but not both, or topics (--topic)"
        )
    output = command_line.new_file(options.output)
    with _opened(options) as bag:
        if options.run is not None:
            spans = _spans(bag)
            if not 1 <= options.run <= len(spans):
                raise command_line.InputError(
                    f"--run {options.run}: {bag.path} contains {len(spans)} runs"
                )
            first, last = spans[options.run - 1]
        else:
            first = bag.time_at(options.start or 0.0)
            last = bag.time_at(bag.duration_s if options.end is None else options.end)
        count = write_part(bag, output, first, last, options.topic or bag.topics)
    content = {"bag": str(output), "messages": count}
    command_line.print_result(options, content, f"{output}: {count} messages")


def _spans(bag: Bag) -> list[tuple[int, int]]:
    """Return the first and the last log time (ns) of each run. A run includes the time since the previous run's end."""
    from worm_model.analysis.run_metrics import played_gaits
    from worm_model.bags.run_reader import read_run, received_at

    played = played_gaits(read_run(bag, names=("gait_state",)).gait_state)
    received = received_at(bag, "gait_state")
    # The state that ends a run is also the first state of the next part, because its topic is latched.
    end = bag.spans[-1][1]
    ends = [received[gait.end] if gait.end else end for gait in played[:-1]]
    starts = [bag.start, *(end + 1 for end in ends)]
    return list(zip(starts, [*ends, end], strict=True)) if played else []


VERBS = (TABLE, "info", *PARTS)


def _arguments(given: list[str]) -> list[str]:
    """Return the arguments, preceded by the default verb if they begin neither with a verb nor with --help."""
    has_verb = bool(given) and (given[0] in VERBS or given[0] in ("-h", "--help"))
    return given if has_verb else [TABLE, *given]


def main() -> int:
    """Entry point of the executable bags."""
    return command_line.run_command(
        _parser(), lambda options: options.act(options), _arguments(sys.argv[1:])
    )
