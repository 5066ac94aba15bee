# SPDX-License-Identifier: Apache-2.0
"""The run of the demo with its recording, and the comparison of the recording with predictions."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from worm_model.analysis.run_metrics import Window
from worm_model.errors import RecordingError
from worm_model.text_table import text_table
from worm_optimizer.gait_prediction import Prediction
from worm_optimizer.operation.bring_up import (
    CYCLES,
    Say,
    bag_of,
    left_out,
    session,
)
from worm_optimizer.operation.system import RECORDER, System
from worm_optimizer.report.expectation import Bands
from worm_optimizer.report.recorded_gait import RecordedGait
from worm_optimizer.robot_commands import GaitCommand
from worm_optimizer.search.gait_request import GaitRequest, Objective


def run_demo_gait(system: System, logs: Path, say: Say) -> tuple[Prediction, Path]:
    """Start a system, run five cycles of the optimizer's cruise gait, and end all processes.

    Return the prediction and the bag. When this function returns or raises an exception, the bag is closed and all
    processes have ended.

    Args:
        system: the nodes, including a recorder.
        logs: folder of the log files.
        say: called with each line of progress.

    Raises:
        ProcessError, OperatorError: A stage failed. The message contains the node or service, and the reason.
    """
    with session(system, logs, say) as running:
        node = running.node
        prediction = node.request_gait(GaitRequest(Objective.CRUISE))
        gait = prediction.gait
        say(
            f"the optimizer answers: stroke {1e3 * gait.stroke:.1f} mm, frequency "
            f"{gait.frequency:.3f} Hz, margin {1e3 * gait.margin:.1f} mm"
        )
        bag = bag_of(running.group.processes[RECORDER])
        running.activate()
        node.graph.wait_for_recorder(RECORDER, left_out(system.node(RECORDER)))
        say(f"running {CYCLES} cycles, {CYCLES / gait.frequency:.0f} s of the robot's time")
        running.run_gait(GaitCommand(gait, CYCLES))
        running.release()
    return prediction, bag


@dataclass(frozen=True)
class Performance:
    """Performance of a gait according to one source; NaN for a quantity that the source lacks.

    Attributes:
        speed: mean speed along the gait's direction, m/s.
        power: mean source power, W.
        cost_of_transport: cost of transport, 1.
    """

    speed: float
    power: float
    cost_of_transport: float


@dataclass(frozen=True)
class Comparison:
    """Performance in the averaged cycles according to several sources, SI units.

    Attributes:
        window: the averaged cycles.
        measured: measurement of tracker and power sensor.
        twin: prediction of the twin from the recorded lengths.
        predicted: prediction of the optimizer before the run, without the margin.
        robust: prediction of the optimizer before the run, with the margin; the search optimises this prediction.
    """

    window: Window
    measured: Performance
    twin: Performance
    predicted: Performance
    robust: Performance


def compare(gait: RecordedGait, prediction: Prediction) -> Comparison:
    """Return the comparison of a recorded gait with its prediction.

    Raises:
        RecordingError: The gait ended early, its recording is incomplete, or the twin did not follow it.
    """
    for problem in (gait.early_end, *gait.missing):
        if problem:
            raise RecordingError(problem)
    if math.isnan(gait.twin.speed.value) or math.isnan(gait.twin.power.value):
        raise RecordingError("the twin did not follow the recording over the averaged cycles")
    nominal = ("nominal_speed", "nominal_power", "nominal_cost_of_transport")
    return Comparison(
        window=gait.window,
        measured=_means(gait.measured),
        twin=_means(gait.twin),
        predicted=Performance(*(getattr(prediction, name) for name in nominal)),
        robust=Performance(prediction.speed, prediction.power, prediction.cost_of_transport),
    )


def _means(bands: Bands) -> Performance:
    return Performance(bands.speed.value, bands.power.value, bands.cost_of_transport.value)


def relative_difference(value: float, reference: float) -> float:
    """Return (value − reference) / |reference|; NaN if the reference is zero or either is NaN."""
    return (value - reference) / abs(reference) if reference else float("nan")


def comparison_table(measured: Performance, predictions: Mapping[str, Performance]) -> str:
    """Return a text table of the measurement and the predictions, with their relative differences from the measurement.

    The units of the table are mm/s, W and percent.
    """
    rows = [["", "speed", "", "power", "", "cost of transport", ""]]
    rows.append(_row("measured on the robot", measured, None))
    rows += [_row(name, figures, measured) for name, figures in predictions.items()]
    return text_table(rows)


def _row(name: str, figures: Performance, reference: Performance | None) -> list[str]:
    values = {
        "speed": f"{1e3 * figures.speed:.2f} mm/s",
        "power": f"{figures.power:.2f} W",
        "cost_of_transport": f"{figures.cost_of_transport:.1f}",
    }
    cells = [name]
    for field, value in values.items():
        share = ""
        if reference is not None:
            difference = relative_difference(getattr(figures, field), getattr(reference, field))
            share = f"{100.0 * difference:+.1f} %"
        cells += [value, share]
    return cells
