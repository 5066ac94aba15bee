# SPDX-License-Identifier: Apache-2.0
"""A recorded run against its predictions, and the table of it; each number from its own source, none passed on."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from worm_model.analysis.run_metrics import RecordingError, Window
from worm_optimizer.report.expectation import Bands
from worm_optimizer.report.recorded_gait import RecordedGait
from worm_optimizer.robustness.prediction import Prediction

_NAME_WIDTH = 34
_COLUMNS = (
    ("speed", "speed", 12),
    ("power", "power", 9),
    ("cost_of_transport", "cost of transport", 18),
)
_SHARE_WIDTH = 9  # of a relative difference after its value


@dataclass(frozen=True)
class Performance:
    """What one source says of a gait.

    ``speed`` in m/s along the gait's direction, ``power`` the mean source power in W, ``cost_of_transport`` 1; NaN
    where the source does not tell.
    """

    speed: float
    power: float
    cost_of_transport: float


@dataclass(frozen=True)
class Comparison:
    """Numbers of the averaged cycles, all in SI units.

    ``measured`` by the tracker and the power sensor of the robot; ``twin`` by the twin that was
    driven with the recorded lengths; ``predicted`` by the optimizer before the run, without the
    margin; ``robust`` the same with the margin, which the search optimises.
    """

    window: Window
    measured: Performance
    twin: Performance
    predicted: Performance
    robust: Performance


def compare(gait: RecordedGait, prediction: Prediction) -> Comparison:
    """Compares a recorded gait; raises `RecordingError` if it ended early, or its recording lacks something."""
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
    """(value − reference) / |reference|; NaN if the reference is zero or either is NaN."""
    return (value - reference) / abs(reference) if reference else float("nan")


def comparison_table(measured: Performance, predictions: Mapping[str, Performance]) -> str:
    """One row of the measurement, and of each prediction with its relative difference to it.

    Arguments are in SI units; the table shows mm/s, W and percent.
    """
    heads = "".join(f"{head:>{width}}{'':{_SHARE_WIDTH}}" for _, head, width in _COLUMNS)
    lines = [f"{'':{_NAME_WIDTH}}{heads}".rstrip(), _row("measured on the robot", measured)]
    lines += [_row(name, figures, measured) for name, figures in predictions.items()]
    return "\n".join(lines)


def _row(name: str, figures: Performance, reference: Performance | None = None) -> str:
    cells = {
        "speed": f"{1e3 * figures.speed:.2f} mm/s",
        "power": f"{figures.power:.2f} W",
        "cost_of_transport": f"{figures.cost_of_transport:.1f}",
    }
    text = f"{name:{_NAME_WIDTH}}"
    for field, _, width in _COLUMNS:
        share = ""
        if reference is not None:
            value = relative_difference(getattr(figures, field), getattr(reference, field))
            share = f"{100.0 * value:+.1f} %"
        text += f"{cells[field]:>{width}}{share:>{_SHARE_WIDTH}}"
    return text.rstrip()
