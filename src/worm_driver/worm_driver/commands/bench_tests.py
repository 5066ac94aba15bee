# SPDX-License-Identifier: Apache-2.0
"""Command ``bench_tests``: simulate a bellows and a fin test of the virtual robot; write CSV files for ``identify``."""

import argparse
import csv
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from random import Random

from worm_driver.commands.driver_command import run_command
from worm_driver.virtual_robot.virtual_settings import load_settings
from worm_msgs.command_parser import Parser
from worm_msgs.robot_parameters import RobotParameters

#: Standard deviation of the force sensor's noise in the bellows test and in the fin test, N.
_NOISE = 0.35, 0.12
#: Compressions of the bellows test and displacements of the fin test, m.
_COMPRESSION = [0.002 * k for k in range(36)]
_DISPLACEMENT = [0.00025 * (k - 48) for k in range(97)]

Readings = Iterable[tuple[float, float]]


def bellows_test(body: RobotParameters, random: Random) -> Readings:
    """Yield compression (m) and force (N) of the bellows, with sensor noise."""
    for x in _COMPRESSION:
        yield x, body.bellows_stiffness * x + random.gauss(0.0, _NOISE[0])


def fin_test(body: RobotParameters, random: Random) -> Readings:
    """Yield displacement of the fin from its anchor (m; negative: the fin engages) and force (N), with sensor noise."""
    half = 0.5 * body.clearance
    for x in _DISPLACEMENT:
        force = body.engaged_stiffness * min(x + half, 0.0)
        force += body.disengaged_stiffness * max(x - half, 0.0)
        yield x, force + random.gauss(0.0, _NOISE[1])


def _write(path: Path, column: str, rows: Readings) -> None:
    with path.open("x", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow((column, "force_N"))
        writer.writerows((f"{x:.6f}", f"{force:.4f}") for x, force in rows)


def _run(options: argparse.Namespace) -> None:
    settings = load_settings(options.parameters)
    if options.seed is not None:
        settings = replace(settings, seed=options.seed)
    body = settings.true_body
    options.folder.mkdir(parents=True, exist_ok=True)
    random = Random(f"{settings.seed} bench")
    _write(options.folder / "bellows.csv", "compression_m", bellows_test(body, random))
    _write(options.folder / "fin.csv", "displacement_m", fin_test(body, random))


def main(arguments: list[str] | None = None) -> int:
    """Run the command and return the exit status."""
    parser = Parser(
        prog="bench_tests",
        description="Simulate a bellows and a fin test of the virtual robot. Write bellows.csv and fin.csv.",
    )
    parser.add_argument("folder", type=Path, metavar="FOLDER", help="folder for the two files")
    parser.add_argument(
        "--parameters", type=Path, metavar="FILE", help="parameter file of the virtual robot"
    )
    parser.add_argument("--seed", type=int, metavar="N", help="seed of the virtual robot")
    return run_command(parser, _run, arguments)
