# SPDX-License-Identifier: Apache-2.0
"""Success probabilities, compared with robots that the model does not contain."""

import numpy as np
from foreign_robot import crawl, some_robot

from worm_model.gait import Gait
from worm_model.parameters import ParameterFile
from worm_msgs.robot_parameters import TravelError
from worm_optimizer.evaluation.task import MarginTask
from worm_optimizer.robustness.chance import PromiseTask
from worm_optimizer.robustness.uncertainty import phase_known

FREQUENCY = 0.15  # Hz; above 0.2 Hz the bellows of these robots extends too slowly at any stroke
ROBOTS = 24
GROOVES = 2  # per cycle


def stroke_for(content: ParameterFile, probability: float) -> float:
    """Return the shortest stroke that gains the grooves with a probability."""
    promise = PromiseTask(MarginTask(), phase_known(content, 400, seed=3), probability)
    strokes = np.linspace(0.05, 0.09, 9)[np.newaxis]
    edges = promise.edges(np.array([FREQUENCY]), strokes).points
    (stroke,) = edges.stroke[edges.count == 3 * GROOVES]
    return float(stroke)


def share_kept(stroke: float) -> float:
    gait = Gait(stroke, FREQUENCY)
    kept = [
        crawl(some_robot(seed), gait).grooves(5, FREQUENCY)[2:].min() >= GROOVES
        for seed in range(ROBOTS)
    ]
    return float(np.mean(kept))


def test_gaits_for_95_percent_keep_their_grooves_on_88_to_100_percent_of_robots() -> None:
    assert share_kept(stroke_for(ParameterFile(), 0.95)) >= 0.88


def test_without_the_travel_error_the_promise_is_broken() -> None:
    exact = ParameterFile(travel_error=TravelError(0.0, 0.0))
    assert share_kept(stroke_for(exact, 0.95)) < 0.88
