# SPDX-License-Identifier: Apache-2.0
"""Command line: table of the recorded runs, and operations on whole bags, one verb each."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

from worm_model.commands import command_line

if TYPE_CHECKING:
    from worm_model.bags.formats.bag import Bag

TABLE = "table"
FOLDER = Path("bags")  # where ./worm records


def _parser() -> command_line.Parser:
    parser = command_line.Parser(
        prog="bags",
        description="Print a table of the recorded runs below a folder, or process bags with a VERB. `bags FOLDER` "
        "means `bags table FOLDER`.",
    )
    verbs = parser.add_subparsers(
        dest="verb", required=True, metavar="VERB", parser_class=command_line.Parser
    )

    def add_verb(
        name: str, act: Callable[[argparse.Namespace], None], bags: str | None = None, **texts: Any
    ) -> command_line.Parser:
        verb: command_line.Parser = verbs.add_parser(name, **texts)
        verb.set_defaults(act=act)
        verb.add_json()
        if name != TABLE:
            verb.add_argument("bag", type=Path, nargs=bags, metavar="BAG")
        return verb

    def add_output(
        verb: command_line.Parser, metavar: str = "BAG2", meaning: str = "must not exist"
    ) -> None:
        verb.add_argument("--output", required=True, metavar=metavar, help=meaning)
        verb.add_definitions()

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
    trim = add_verb(
        "trim",
        _trim,
        help="write a part of a bag, by time or by run",
        description="Write a bag with the messages of a span, or of one run and the time since the previous run.",
    )
    add_output(trim)
    trim.add_number("--start", "S", "start of the span, in s since the start of the bag")
    trim.add_number("--end", "S", "end of the span, in s since the start of the bag")
    trim.add_argument(
        "--run", type=int, metavar="N", help="number of the run, from 1, instead of a span"
    )
    split = add_verb("split", _split, help="write a bag for each run of a bag")
    add_output(split, "FOLDER", "folder for run_1, run_2, …; must not exist")
    add_output(add_verb("merge", _merge, "+", help="merge several bags into one, ordered by time"))
    clean = add_verb(
        "clean",
        _clean,
        help="copy a bag without the host's name and absolute paths",
        description="Write a copy of a bag that does not reveal where it was recorded. The host's name is removed, "
        "and every absolute path (command line, parameter file, devices; in metadata, attachments and texts of "
        "messages) is reduced to its last part. Names of the robot's topics do not change.",
    )
    add_output(clean)
    return parser


def _table(options: argparse.Namespace) -> None:
    from worm_model.commands.bag_table import bag_rows, describe

    rows, _ = bag_rows(options.folder, options.parameters, command_line.ProgressLine("bags"))
    command_line.print_result(options, {"runs": rows}, describe(rows, options.folder))


def _opened(options: argparse.Namespace, path: Path | None = None) -> Bag:
    """Open a bag, by default the bag of the options."""
    from worm_model.bags.opening import open_bag

    notify = command_line.notifier(f"bags {options.verb}")
    return open_bag(path or options.bag, notify, getattr(options, "definitions", None))


def _info(options: argparse.Namespace) -> None:
    with _opened(options) as bag:
        content: dict[str, Any] = {
            "bag": str(bag.path),
            "start_ns": bag.start,
            "duration_s": (bag.end - bag.start) * 1e-9,
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


def _trim(options: argparse.Namespace) -> None:
    from worm_model.bags.operations.cutting import trim

    if (options.run is None) == (options.start is None and options.end is None):
        raise command_line.InputError("give a span (--start, --end or both) or --run, but not both")
    output = command_line.new_file(options.output)
    with _opened(options) as bag:
        first, last = bag.start, bag.end
        if options.run is not None:
            spans = _spans(bag)
            if not 1 <= options.run <= len(spans):
                raise command_line.InputError(
                    f"--run {options.run}: {bag.path} contains {len(spans)} runs"
                )
            first, last = spans[options.run - 1]
        elif options.start is not None:
            first = bag.start + round(options.start * 1e9)
        if options.end is not None:
            last = bag.start + round(options.end * 1e9)
        count = trim(bag, output, first, last)
    _written(options, {"bag": str(output), "messages": count})


def _spans(bag: Bag) -> list[tuple[int, int]]:
    """Return the first and the last log time (ns) of each run. A run includes the time since the previous run's end."""
    from worm_model.analysis.run_metrics import played_gaits
    from worm_model.bags.run_reader import read_run, received_at

    played = played_gaits(read_run(bag, names=("gait_state",)).gait_state)
    received = received_at(bag, "gait_state")
    # The state that ends a run is also the first state of the next part, because its topic is latched.
    ends = [received[gait.end] if gait.end else bag.end for gait in played[:-1]]
    starts = [bag.start, *(end + 1 for end in ends)]
    return list(zip(starts, [*ends, bag.end], strict=True)) if played else []


def _split(options: argparse.Namespace) -> None:
    from worm_model.bags.formats.whole_folder import new_folder
    from worm_model.bags.operations.cutting import trim

    output = command_line.new_file(options.output)
    with _opened(options) as bag:
        spans = _spans(bag)
        if not spans:
            raise command_line.InputError(
                f"{bag.path}: contains no run. Use `bags trim` to cut by time"
            )
        made = [f"run_{number}" for number in range(1, len(spans) + 1)]
        with new_folder(output) as folder:
            counts = [
                trim(bag, folder / name, *span) for name, span in zip(made, spans, strict=True)
            ]
    _written(options, {"bags": [str(output / name) for name in made], "messages": sum(counts)})


def _merge(options: argparse.Namespace) -> None:
    from worm_model.bags.operations.cutting import merge

    output = command_line.new_file(options.output)
    with ExitStack() as stack:
        count = merge([stack.enter_context(_opened(options, path)) for path in options.bag], output)
    _written(options, {"bag": str(output), "messages": count})


def _written(options: argparse.Namespace, content: dict[str, Any]) -> None:
    where = content.get("bag") or ", ".join(content["bags"])
    command_line.print_result(options, content, f"{where}: {content['messages']} messages")


def _clean(options: argparse.Namespace) -> None:
    from worm_model.bags.operations.cleaning import clean_bag

    output = command_line.new_file(options.output)
    with _opened(options) as bag:
        count = bag.message_count
        cleaner = clean_bag(bag, output)
    content = {"bag": str(output), "messages": count, "changed": cleaner.changed}
    text = f"{output}: {count} messages, {cleaner.changed} of them with changed texts"
    command_line.print_result(options, content, text)


VERBS = (TABLE, "info", "trim", "split", "merge", "clean")


def _arguments(given: list[str]) -> list[str]:
    """Return the arguments, preceded by the default verb if they begin neither with a verb nor with --help."""
    has_verb = bool(given) and (given[0] in VERBS or given[0] in ("-h", "--help"))
    return given if has_verb else [TABLE, *given]


def main() -> int:
    """Entry point of the executable bags."""
    return command_line.run_command(
        _parser(), lambda options: options.act(options), _arguments(sys.argv[1:])
    )
