# SPDX-License-Identifier: Apache-2.0
"""A recorded run against its predictions, and the table of it; each number from its own source, none passed on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from worm_model.analysis.run_metrics import (
    Performance,
    Window,
    accumulated_energy,
    averaged_cycles,
    last_played_gait,
    performance,
)
from worm_model.parameters import Parameters
from worm_model.run import Run
from worm_model.twin.offline_replay import Replay
from worm_optimizer.robustness.prediction import Prediction

_NAME_WIDTH = 34
_COLUMNS = (
    ("speed", "speed", 12),
    ("power", "power", 9),
    ("cost_of_transport", "cost of transport", 18),
)
_SHARE_WIDTH = 9  # of a relative difference after its value


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


def compare(run: Run, replay: Replay, prediction: Prediction, parameters: Parameters) -> Comparison:
    """Compare the last gait of a run; raises `RecordingError` if the recording lacks something."""
    played = last_played_gait(run.gait_state)
    window = played.cycle_window(*averaged_cycles(run, played))
    mass, direction = parameters.mass, played.gait.direction
    tracker, states = run.tracker, replay.states
    return Comparison(
        window=window,
        measured=performance(
            (tracker.stamp, tracker.rear_position),
            accumulated_energy((run.power.stamp, run.power.valid_power)),
            mass,
            window,
            direction,
        ),
        twin=performance(
            (states["stamp_ns"], states["rear_position"]),
            (states["stamp_ns"], states["energy"]),
            mass,
            window,
            direction,
        ),
        predicted=Performance(
            prediction.nominal_speed,
            prediction.nominal_power,
            prediction.nominal_cost_of_transport,
        ),
        robust=Performance(prediction.speed, prediction.power, prediction.cost_of_transport),
    )


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
