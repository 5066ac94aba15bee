# SPDX-License-Identifier: Apache-2.0
"""A recorded run against its predictions; each number from its own source, none passed on."""

from __future__ import annotations

from dataclasses import dataclass

from worm_model.analysis.run_metrics import (
    Performance,
    Window,
    accumulated_energy,
    last_cycles_of,
    last_played_gait,
    performance,
)
from worm_model.parameters import Parameters
from worm_model.run import Run
from worm_model.twin.offline_replay import Replay
from worm_optimizer.robustness.prediction import Prediction


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
    window = played.cycle_window(*last_cycles_of(played.cycles))
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
