# SPDX-License-Identifier: Apache-2.0
"""Command line: simulation of a gait, as a table, a figure, an animation or a bag."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from worm_model.commands.command_line import (
    InputError,
    Parser,
    ProgressLine,
    executable,
    new_file,
    print_result,
)
from worm_model.commands.evaluate_gait import describe, gait_json
from worm_model.gait import AVERAGED, Gait, gait_of
from worm_model.loads import under
from worm_model.parameters import load_parameters
from worm_msgs.conditions import conditions_of

if TYPE_CHECKING:
    from worm_model.analysis.simulated_run import SimulatedRun

CYCLES = 5  # number of cycles in the paper's protocol
MOST_SAMPLES = 10_000_000  # largest number of samples in a file
MOST_CYCLES = 1000  # largest number of cycles of a simulation
FIGURES = (".png", ".pdf", ".svg")
ANIMATIONS = (".gif", ".mp4")
RATE_HZ = 100.0  # default sampling rate of tables, figures and recordings
FRAME_RATE_HZ = 12.5  # default frame rate of an animation


def _parser() -> Parser:
    parser = Parser(
        prog="simulate",
        description="Simulate a gait from rest. The ending of --output selects the form: a table of positions, "
        "anchors, length, cable force, power and energy (.csv), a figure of positions, anchors, length, forces and "
        "power (.png, .pdf, .svg), an animation of the robot in its pipe in real time (.gif, or .mp4 if ffmpeg is "
        "installed), or a recording by ideal instruments, with two seconds of rest before the gait (.mcap).",
    )
    parser.add_gait(required=True)
    parser.add_conditions()
    parser.add_argument(
        "--cycles", type=int, default=CYCLES, metavar="N", help=f"cycles (default: {CYCLES})"
    )
    parser.add_number(
        "--rate",
        "HZ",
        f"samples a second (default: {RATE_HZ:g}), or frames a second of an animation (default: {FRAME_RATE_HZ:g})",
    )
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


def _write_animation(run: SimulatedRun, path: Path) -> None:
    from worm_model.analysis.gait_animation import write_animation

    write_animation(run, path, ProgressLine("frames"))


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


def _writer_of(path: Path) -> Callable[[SimulatedRun, Path], None]:
    writers = {".csv": _write_table, ".mcap": _write_recording}
    writers |= dict.fromkeys(FIGURES, _write_figure)
    writers |= dict.fromkeys(ANIMATIONS, _write_animation)
    if path.suffix.lower() not in writers:
        raise InputError(f"--output {path}: end its name in {', '.join(writers)}")
    return writers[path.suffix.lower()]


def _checked_rate(options: argparse.Namespace, gait: Gait, output: Path) -> float:
    """Return the sampling rate in Hz; raise `InputError` if the number of samples or frames is out of range."""
    animated = output.suffix.lower() in ANIMATIONS
    rate: float = options.rate
    if rate is None:
        rate = FRAME_RATE_HZ if animated else RATE_HZ
    samples = options.cycles * gait.period * rate
    if not 1.0 <= samples <= MOST_SAMPLES:
        raise InputError(
            f"--rate {rate:g}: {samples:.0f} samples; a file may have 1 to {MOST_SAMPLES}. Change --rate or --cycles"
        )
    if animated:
        from worm_model.analysis.gait_animation import check_animation

        check_animation(output, rate, samples)
    return rate


def _run(options: argparse.Namespace) -> None:
    gait = gait_of(options)
    if not 1 <= options.cycles <= MOST_CYCLES:
        raise InputError(f"--cycles {options.cycles}: 1 to {MOST_CYCLES} can be simulated")
    output = new_file(options.output)
    write = _writer_of(output)
    rate = _checked_rate(options, gait, output)
    conditions = conditions_of(options)
    parameters = under(conditions, load_parameters(options.parameters))
    from worm_model.analysis.simulated_run import simulated_run
    from worm_model.simulation.simulator import evaluate_gait

    run = simulated_run(gait, parameters, options.cycles, rate)
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
