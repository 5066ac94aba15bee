# SPDX-License-Identifier: Apache-2.0
"""Command line: simulation of a gait, as a table, a figure or a bag."""

from __future__ import annotations

import argparse
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from worm_model.commands.command_line import (
    FIGURES,
    InputError,
    Parser,
    executable,
    new_file,
    print_result,
)
from worm_model.commands.evaluate_gait import describe, gait_json
from worm_model.gait import AVERAGED, CYCLES, gait_of
from worm_model.loads import under
from worm_model.parameters import load_parameters
from worm_msgs.conditions import conditions_of

if TYPE_CHECKING:
    from worm_model.analysis.simulated_run import SimulatedRun

MOST_SAMPLES = 10_000_000  # largest number of samples in a file
MOST_CYCLES = 1000  # largest number of cycles of a simulation


def _parser() -> Parser:
    parser = Parser(
        prog="simulate",
        description="Simulate a gait from rest. The ending of --output selects the form: a table of positions, "
        "anchors, length, cable force, power and energy (.csv), a figure of positions, anchors, length, forces and "
        "power (.png, .pdf, .svg), or a recording by ideal instruments, with two seconds of rest before the gait "
        "(.mcap).",
    )
    parser.add_gait(required=True)
    parser.add_conditions()
    parser.add_argument(
        "--cycles", type=int, default=CYCLES, metavar="N", help=f"cycles (default: {CYCLES})"
    )
    parser.add_number("--rate", "HZ", "samples a second", 100.0)
    parser.add_argument("--output", required=True, metavar="FILE", help="new file; must not exist")
    parser.add_json()
    parser.add_parameters()
    return parser


def _write_table(run: SimulatedRun, path: Path) -> None:
    import numpy as np

    columns = run.table()
    with path.open("x", encoding="utf-8") as file:
        rows = np.column_stack(list(columns.values()))
        np.savetxt(file, rows, fmt="%.12g", delimiter=",", header=",".join(columns), comments="")


def _write_figure(run: SimulatedRun, path: Path) -> None:
    from worm_model.analysis.plot_style import save_figure
    from worm_model.analysis.run_curves import plot_simulated_run

    save_figure(plot_simulated_run(run), path)


def _write_recording(run: SimulatedRun, path: Path) -> None:
    """Write the recording as a single MCAP file; the topic twin/state contains anchors and forces."""
    from worm_model.bags.formats.bag_writer import new_bag
    from worm_model.bags.formats.message_types import topic_of
    from worm_model.bags.recording.run_manifest import RUN_RECORD
    from worm_model.bags.run_writer import stamped_messages, write_run
    from worm_model.bags.worm_topics import TYPES, offered_qos

    name = "twin/state"
    with TemporaryDirectory(prefix=f".{path.stem}.", dir=path.parent) as folder:
        with new_bag(Path(folder, path.stem)) as writer:
            writer.add_metadata(RUN_RECORD, run.provenance())
            write_run(writer, run.as_recorded())
            topic = topic_of(f"/worm/{name}", TYPES[name], offered_qos(name))
            writer.add_topic(topic)
            writer.write_all(stamped_messages(topic, run.stamp, run.twin_states()))
        Path(folder, path.stem, f"{path.stem}_0.mcap").rename(path)


WRITERS = {
    ".csv": _write_table,
    ".mcap": _write_recording,
    **dict.fromkeys(FIGURES, _write_figure),
}


def _run(options: argparse.Namespace) -> None:
    gait = gait_of(options)
    if not 1 <= options.cycles <= MOST_CYCLES:
        raise InputError(f"--cycles {options.cycles}: 1 to {MOST_CYCLES} can be simulated")
    output = new_file(options.output)
    write = WRITERS.get(output.suffix.lower())
    if write is None:
        raise InputError(f"--output {output}: end its name in {', '.join(WRITERS)}")
    samples = options.cycles * gait.period * options.rate
    if not 1.0 <= samples <= MOST_SAMPLES:
        raise InputError(
            f"--rate {options.rate:g}: {samples:.0f} samples; a file may have 1 to {MOST_SAMPLES}. "
            "Change --rate or --cycles"
        )
    conditions = conditions_of(options)
    parameters = under(conditions, load_parameters(options.parameters))
    from worm_model.analysis.simulated_run import simulated_run
    from worm_model.simulation.simulator import evaluate_gait

    run = simulated_run(gait, parameters, options.cycles, options.rate)
    figures = evaluate_gait(gait, parameters, options.cycles, min(AVERAGED, options.cycles))
    write(run, output)
    content = {
        "output": str(output),
        "samples": int(run.time.size),
        **gait_json(figures, conditions),
    }
    text = f"{describe(figures, parameters, options.cycles)}\n{run.time.size} samples written to {output}"
    print_result(options, content, text)


main = executable(_parser, _run)
