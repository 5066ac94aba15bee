# SPDX-License-Identifier: Apache-2.0
"""A recorded run against its predictions; each number from its own source, none passed on."""

from __future__ import annotations

from dataclasses import dataclass

from worm_model.parameters import Parameters
from worm_model.run import Run
from worm_model.twin.offline_replay import Replay
from worm_optimizer.operation.gait_figures import (
    Figures,
    Window,
    accumulate,
    averaged_window,
    figures,
)
from worm_optimizer.robustness.prediction import Prediction


@dataclass(frozen=True)
class Comparison:
    """Figures of the averaged cycles, all in SI units.

    ``measured`` by the tracker and the power sensor of the robot; ``twin`` by the twin that was
    driven with the recorded lengths; ``predicted`` by the optimizer before the run, without the
    margin; ``robust`` the same with the margin, which the search optimises.
    """

    window: Window
    measured: Figures
    twin: Figures
    predicted: Figures
    robust: Figures


def compare(run: Run, replay: Replay, prediction: Prediction, parameters: Parameters) -> Comparison:
    """Compare the last gait of a run; raises `RecordingError` if the recording lacks something."""
    window = averaged_window(run.gait_state)
    mass = parameters.mass
    tracker, states = run.tracker, replay.states
    return Comparison(
        window=window,
        measured=figures(
            (tracker.stamp, tracker.rear_position),
            accumulate(run.power.stamp, run.power.valid_power),
            mass,
            window,
        ),
        twin=figures(
            (states["stamp_ns"], states["rear_position"]),
            (states["stamp_ns"], states["energy"]),
            mass,
            window,
        ),
        predicted=Figures(
            prediction.nominal_speed,
            prediction.nominal_power,
            prediction.nominal_cost_of_transport,
        ),
        robust=Figures(prediction.speed, prediction.power, prediction.cost_of_transport),
    )
