# SPDX-License-Identifier: Apache-2.0
"""Command line: conversion of a lab's CSV files to a bag with the topics of the driver and the tracker."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from worm_model.commands import command_line

if TYPE_CHECKING:  # Numba loads slowly
    from worm_model.identification.data.lab_logs import LabRun, LabSettings

_notify = command_line.notifier("import_lab")
EPOCH_S = 1767225600  # 2026-01-01 00:00 UTC; the logs have no date, and a stamp of 0 means "unknown" in ROS

_LARGEST_SPOOL = 0.2  # m, largest accepted spool radius
_LONGEST_BODY = 2.0  # m, largest accepted initial length


def import_lab(folder: Path, output: Path, settings: LabSettings) -> LabRun:
    """Convert a run's folder to a bag. Equal files, folder names and settings produce equal bytes."""
    from worm_model.bags.formats.bag_writer import new_bag
    from worm_model.bags.run_writer import write_run
    from worm_model.identification.data.lab_logs import read_lab_run

    lab = read_lab_run(folder, settings)
    with new_bag(output) as writer:
        writer.add_metadata("worm_run", _manifest(folder, lab))
        write_run(writer, lab.run)
    return lab


def _manifest(folder: Path, lab: LabRun) -> dict[str, str]:
    return {
        "imported_from": folder.resolve().name,
        "initial_length": repr(lab.initial_length),
        "spool_radius": repr(lab.spool_radius),
        **{f"sha256.{name}": checksum for name, checksum in lab.checksums.items()},
    }


def _parser() -> command_line.Parser:
    parser = command_line.Parser(
        prog="import_lab",
        description="Convert a lab's run to a bag: camera.csv, power.csv and servo.csv in FOLDER, and the gait in "
        "runs.json in FOLDER or in its parent folder.",
    )
    parser.add_argument("folder", type=Path, metavar="FOLDER", help="the run's folder")
    parser.add_argument("--output", required=True, metavar="BAG", help="new bag; must not exist")
    parser.add_number(
        "--onset", "S", "start of the gait in s of the logs; default: from the servo's log"
    )
    parser.add_number(
        "--spool-radius",
        "M",
        "spool radius of the cable servo in m; default: computed from the servo's goals and the stroke",
    )
    parser.add_number(
        "--initial-length",
        "M",
        "initial length in m; default: the camera's measurement at rest, without the pretension's effect",
    )
    parser.add_argument(
        "--epoch",
        type=command_line.number,
        default=EPOCH_S,
        metavar="S",
        help="time t = 0 of the logs, in s since 1970-01-01 UTC; 0 if the logs count from 1970 (default: 2026-01-01)",
    )
    parser.add_json()
    return parser


def _run(options: argparse.Namespace) -> None:
    from worm_model.identification.data.lab_logs import LabSettings

    if options.spool_radius is not None:
        _check_length("--spool-radius", options.spool_radius, _LARGEST_SPOOL)
    if options.initial_length is not None:
        _check_length("--initial-length", options.initial_length, _LONGEST_BODY)
    settings = LabSettings(
        epoch=round(options.epoch * 1e9),
        onset=options.onset,
        spool_radius=options.spool_radius,
        initial_length=options.initial_length,
    )
    output = command_line.new_file(options.output)
    lab = import_lab(options.folder, output, settings)
    for remark in lab.remarks:
        _notify(remark)
    positions = [lab.run.tracker.rear_position, lab.run.tracker.front_position]
    counts = {
        "commanded": len(lab.run.commanded.stamp),
        "tracker": len(lab.run.tracker.stamp),
        "occluded": int(np.isnan(positions).any(axis=0).sum()),
        "power": len(lab.run.power.stamp),
    }
    content = {"bag": str(output), "initial_length": lab.initial_length, **counts}
    summary = (
        f"{counts['commanded']} commanded lengths, {counts['tracker']} tracker samples ({counts['occluded']} "
        f"occluded), {counts['power']} power samples"
    )
    command_line.print_result(
        options, content, f"{output}: {summary}; initial length {lab.initial_length:.4f} m"
    )


def _check_length(option: str, value: float, most: float) -> None:
    if not 0.0 < value <= most:
        raise command_line.InputError(
            f"{option} {value:g}: give a length in m, above 0 and at most {most:g}"
        )


main = command_line.executable(_parser, _run)
