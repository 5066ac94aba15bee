# SPDX-License-Identifier: Apache-2.0
"""The paper's identification with a robot in it: runs past five ridges, each in a bag of its own, and what they say."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from worm_model.gait import Gait
from worm_model.identification.advice import advise
from worm_model.identification.identification_report import write_report
from worm_model.identification.inputs import read_inputs
from worm_model.identification.locomotion import RIDGES
from worm_model.identification.reference_values import reference_by_file
from worm_model.identification.results import parameter_file, summary
from worm_model.identification.stages import identify
from worm_model.parameters import ParameterFile, write_parameter_file
from worm_optimizer.operation.bring_up import Say, Session
from worm_optimizer.operation.campaign_runs import Prepare, Robot, run_gaits
from worm_optimizer.operation.processes import ProcessError, ProcessGroup, executable_command
from worm_optimizer.orders import Order

# Three frequencies tell the damping from the power factor, which one cannot (docs/model.md); strokes tell gain from
# slack. Each passes the ridges at every groove phase.
GAITS = (
    Gait(0.07, 0.1),
    Gait(0.07, 0.2),
    Gait(0.07, 0.3),
    Gait(0.08, 0.15),
    Gait(0.08, 0.25),
    Gait(0.09, 0.2),
)
_BEYOND = 0.3  # pitches that a run goes on past the last ridge, as one outlier is no arrival
_MOST_CYCLES = 12  # a gait that has not passed them then never will, as identify's advice has it
BENCH, BENCH_S = "bench_tests", 60.0
RUNS, PARAMETERS = "identification", "parameters.yaml"
REPORT, SUMMARY = "identification_report", "identification.json"


@dataclass(frozen=True)
class Bench:
    """Files of the bench tests, None where there are none."""

    bellows: Path | None
    fin: Path | None


def identification_orders(direction: int, pitch: float) -> dict[str, Order]:
    """The runs by name; ``pitch`` in m."""
    distance = (RIDGES + _BEYOND) * pitch
    return {
        f"stroke_{1e3 * gait.stroke:.0f}_mm_{gait.frequency:g}_Hz".replace(".", "_"): Order(
            Gait(gait.stroke, gait.frequency, direction), cycles=_MOST_CYCLES, distance=distance
        )
        for gait in GAITS
    }


def record_identification(
    robot: Robot, orders: dict[str, Order], folder: Path, logs: Path, say: Say, prepare: Prepare
) -> list[Path]:
    """Runs what is not recorded yet into ``folder/identification``; returns the bags. Raises as `run_gaits`.

    ``prepare`` puts the robot back before each, see `put_back`.
    """
    runs = folder / RUNS
    runs.mkdir(exist_ok=True)
    run_gaits(robot, orders, runs, logs, say, prepare)
    return [runs / name for name in orders]


def put_back(running: Session, text: str) -> None:
    """The hand of a virtual robot: puts it back where it started, as identification takes the ridges for the same."""
    running.node.inject_fault("put_back")
    running.say(f"put back; {text}")


def virtual_bench(robot: Robot, folder: Path, logs: Path) -> Bench:
    """The bench tests of the virtual robot that ran, made where they are not there yet. Raises `ProcessError`."""
    bench = folder / BENCH
    if not bench.exists():
        words = [str(bench)]
        for name, option in (("plant", "--parameters"), ("seed", "--seed")):
            if value := robot.settings.get(name, ""):
                words += [option, value]
        with ProcessGroup(logs) as group:
            command = [*executable_command("worm_driver", "bench_tests"), *words]
            process = group.start("bench_tests", command)
            if process.wait(BENCH_S) != 0:
                raise ProcessError(f"bench_tests: {process.last_line()}")
    return Bench(bench / "bellows.csv", bench / "fin.csv")


def identify_robot(
    bags: list[Path],
    bench: Bench,
    known: tuple[ParameterFile, str],
    folder: Path,
    progress: Callable[[str, float], None],
) -> dict[str, Any]:
    """Identifies, and writes parameter file and report into a folder; returns what `identify --json` prints.

    ``known`` holds masses, pitch and unstressed length with their source. Raises `IdentificationError`.
    """
    inputs = read_inputs(bags, bench.bellows, bench.fin)
    result = identify(inputs, reference_by_file(*known), progress=progress)
    advice = advise(result)
    write_report(result, advice, folder / REPORT, lambda done: progress("report", done))
    write_parameter_file(folder / PARAMETERS, parameter_file(result, inputs))
    return summary(result) | {"advice": advice}
