# SPDX-License-Identifier: Apache-2.0
"""Identification of a robot: recorded runs past five ridges, bench tests, and the fit of the parameters."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from worm_model.gait import Gait
from worm_model.identification.fits.locomotion import RIDGES
from worm_model.identification.inputs import read_inputs
from worm_model.identification.reference_values import reference_by_file
from worm_model.identification.report.advice import advise
from worm_model.identification.report.identification_report import (
    parameter_file,
    summary,
    write_report,
)
from worm_model.identification.stages import identify
from worm_model.parameters import ParameterFile, write_parameter_file
from worm_optimizer.operation.bring_up import Session
from worm_optimizer.operation.processes import ProcessError, ProcessGroup, executable_command
from worm_optimizer.operation.system import Robot
from worm_optimizer.robot_commands import GaitCommand

# Several frequencies are needed to separate damping and power factor (docs/model.md), several strokes to separate gain
# and slack. Each of these gaits passes the ridges (`RIDGES`) at any groove phase.
GAITS = (
    Gait(0.07, 0.1),
    Gait(0.07, 0.2),
    Gait(0.07, 0.3),
    Gait(0.08, 0.15),
    Gait(0.08, 0.25),
    Gait(0.09, 0.2),
)
# A run ends at this distance beyond the last ridge, in pitches, so that a single outlier of the tracker does not end
# the run too early.
_BEYOND = 0.3
# Largest number of cycles of a run. A gait that has not passed the ridges by then is not expected to pass them. The
# advice of `identify` has the same limit.
_MOST_CYCLES = 12
BENCH, BENCH_S = "bench_tests", 60.0  # folder of the bench tests, and their timeout (s)
# Names of the results in the folder of a campaign: folder of the bags, parameter file, folder of the report, summary
RUNS, PARAMETERS = "identification", "parameters.yaml"
REPORT, SUMMARY = "identification_report", "identification.json"


def identification_orders(direction: int, pitch: float) -> dict[str, GaitCommand]:
    """Return the runs of the identification by name.

    Args:
        direction: FORWARD or REVERSE.
        pitch: distance between two grooves, m.
    """
    distance = (RIDGES + _BEYOND) * pitch
    return {
        f"stroke_{1e3 * gait.stroke:.0f}_mm_{gait.frequency:g}_Hz".replace(".", "_"): GaitCommand(
            replace(gait, direction=direction), cycles=_MOST_CYCLES, distance=distance
        )
        for gait in GAITS
    }


def put_back(running: Session, _text: str) -> None:
    """Move a virtual robot back to its start, because the identification assumes the same ridges in all runs."""
    running.node.inject_fault("put_back")
    running.say("the robot is back at its start")


def virtual_bench(robot: Robot, folder: Path, logs: Path) -> tuple[Path, Path]:
    """Return the files of a virtual robot's bellows and fin test. Simulate the tests if their folder is missing.

    Raises `ProcessError` if the simulation fails.
    """
    bench = folder / BENCH
    if not bench.exists():
        words = []
        for name, option in (("plant", "--parameters"), ("seed", "--seed")):
            if value := robot.settings.get(name, ""):
                words += [option, value]
        # The folder is renamed into place only when both files are complete. If the campaign is interrupted before, the
        # next call finds no folder and simulates the tests again.
        with TemporaryDirectory(prefix=".bench_tests_", dir=folder) as part:
            with ProcessGroup(logs) as group:
                made = Path(part) / BENCH
                command = [*executable_command("worm_driver", "bench_tests"), str(made), *words]
                process = group.start("bench_tests", command)
                if process.wait(BENCH_S) != 0:
                    raise ProcessError(f"bench_tests: {process.last_line()}")
            made.rename(bench)
    return bench / "bellows.csv", bench / "fin.csv"


def identify_robot(
    bags: list[Path],
    bench: tuple[Path | None, Path | None],
    known: tuple[ParameterFile, str],
    folder: Path,
    progress: Callable[[str, float], None],
) -> dict[str, Any]:
    """Identify the parameters, write parameter file and report, and return the content of `identify --json`.

    Args:
        bags: the recorded runs.
        bench: files of the bellows and the fin test; None if missing.
        known: parameters from which masses, pitch and unstressed length are used, and their source as text.
        folder: folder of the results.
        progress: called with the name of a stage and its finished share.
    """
    inputs = read_inputs(bags, *bench)
    result = identify(inputs, reference_by_file(*known), progress=progress)
    advice = advise(result)
    write_report(result, advice, folder / REPORT, lambda done: progress("report", done))
    write_parameter_file(folder / PARAMETERS, parameter_file(result, inputs))
    return summary(result) | {"advice": advice}
