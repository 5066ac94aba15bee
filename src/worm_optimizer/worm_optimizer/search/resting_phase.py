# SPDX-License-Identifier: Apache-2.0
"""Gaits for where a robot rests now: its groove phase decides how many grooves a stroke gains (`docs/model.md`)."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from worm_model.parameters import ParameterFile
from worm_model.simulation.simulator import cost_of_transport
from worm_optimizer.robustness.prediction import Prediction, predict
from worm_optimizer.search.front import RobustFront, task_of
from worm_optimizer.search.gait_request import GaitAnswer, GaitRequest, RequestStatus, select
from worm_optimizer.search.optimizer_errors import OptimizerError
from worm_optimizer.search.pareto import front_of
from worm_optimizer.search.search_settings import Settings
from worm_optimizer.search.task import MarginTask, Points

SAME_LENGTH = (
    1e-4  # m, an initial length that differs by less is the same: a camera tells no better
)
_STROKES, _FREQUENCIES = (
    161,
    15,
)  # of the grid that is searched: half a millimetre; a fifth of a second


def resting_answer(
    front: RobustFront,
    content: ParameterFile,
    settings: Settings,
    request: GaitRequest,
    initial_length: float,
) -> GaitAnswer:
    """Answers a request for a robot that rests with an initial length (m), with the margin of a front.

    The frequencies are the front's, the strokes searched anew on a grid over the box. Raises `OptimizerError` on a
    length that no robot of these parameters has.
    """
    parameters = content.parameters
    if not abs(initial_length - parameters.initial_length) < parameters.initial_length / 2.0:
        raise OptimizerError(
            f"initial_length: {initial_length} m is far from the parameters' {parameters.initial_length} m"
        )
    here = dataclasses.replace(
        content, parameters=dataclasses.replace(parameters, initial_length=initial_length)
    )
    task = task_of(here, settings, front.direction)
    resting_front = _front_here(task.with_margin(front.margin), front)
    if not len(resting_front):
        return GaitAnswer(
            RequestStatus.UNREACHABLE,
            f"no gait moves with a margin of {1e3 * front.margin:.2f} mm at this groove phase: optimise with a "
            "smaller margin, or bring the robot to another place",
        )
    chosen = select(_candidates(resting_front, front, here), request)
    assert chosen.prediction is not None
    gait = chosen.prediction.gait
    (prediction,) = predict(
        task,
        here,
        np.array([gait.stroke]),
        np.array([gait.frequency]),
        np.array([gait.margin]),
        settings.samples,
        settings.search.seed,
    )
    message = chosen.message or f"margin {1e3 * front.margin:.2f} mm, at the robot's groove phase"
    return dataclasses.replace(chosen, message=message, prediction=prediction)


def _front_here(task: MarginTask, front: RobustFront) -> Points:
    frequencies = np.unique([gait.frequency for gait in front.predictions])
    rows = np.linspace(0, frequencies.size - 1, min(_FREQUENCIES, frequencies.size)).round()
    strokes = np.linspace(task.bounds.stroke_low, task.bounds.stroke_high, _STROKES)
    grid = np.meshgrid(strokes, frequencies[rows.astype(int)])
    return front_of(task.points(grid[0].ravel(), grid[1].ravel()))


def _candidates(points: Points, front: RobustFront, content: ParameterFile) -> list[Prediction]:
    """The points as what a request chooses from, with the robust figures alone."""
    cost = cost_of_transport(points.speed, points.power, content.parameters.mass)
    template = dataclasses.replace(
        front.predictions[0],
        margin=front.margin,
        success_probability=math.nan,  # of a gait that is not chosen yet
        success_probability_any_phase=math.nan,
    )
    return [
        dataclasses.replace(
            template,
            stroke=float(points.stroke[k]),
            frequency=float(points.frequency[k]),
            speed=float(points.speed[k]),
            power=float(points.power[k]),
            cost_of_transport=float(cost[k]),
            grooves_per_cycle=float(points.branch[k]),
        )
        for k in range(len(points))
    ]
