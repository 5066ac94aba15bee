# SPDX-License-Identifier: Apache-2.0
"""Values shared by the optimizer's tests: coarse settings, fronts, and random robots."""

import dataclasses
from functools import cache

import numpy as np

from worm_model.parameters import PAPER, ParameterFile, Parameters
from worm_optimizer.evaluation.task import Task
from worm_optimizer.search.exact import ExactFront, Resolution, Zoom, exact_front
from worm_optimizer.search.front import RobustFront, make_front
from worm_optimizer.search.search_settings import ScanSettings, Settings

COARSE = Resolution(strokes=21, frequencies=17)

# Settings that give a front in a tenth of a second: few frequencies, few margins, few draws.
QUICK = Settings(
    resolution=COARSE, scan=ScanSettings(lowest=0.0, highest=4e-3, step=1e-3), samples=20
)


@cache
def small_front(margin: float = 3.4e-3, direction: int = 1) -> RobustFront:
    """Return the front of the paper's robot at a margin in m, on few frequencies."""
    return make_front(ParameterFile(), dataclasses.replace(QUICK, margin=margin), direction)


def coarse_front(task: Task, frequencies: int = COARSE.frequencies) -> ExactFront:
    """Return the exact front of a task, on few frequencies."""
    resolution = dataclasses.replace(COARSE, frequencies=frequencies)
    return exact_front(task, resolution, Zoom(points=9, rounds=5))


def random_robot(seed: int) -> Parameters:
    """Return a robot with any groove phase and parameters within a factor of two of the paper's."""
    random = np.random.default_rng(seed)
    plain = PAPER.as_dict()
    varied = ("rear_mass", "front_mass", "viscous_friction", "engaged_stiffness", "clearance")
    varied += ("disengaged_stiffness", "time_constant", "slack", "bellows_stiffness")
    drawn = {key: plain[key] * random.uniform(0.5, 1.8) for key in varied}
    drawn["pitch"] = plain["pitch"] * random.uniform(0.6, 1.2)
    drawn["gain"] = random.uniform(0.75, 1.0)
    threshold = max(random.uniform(0.7, 1.1) * drawn["pitch"], 0.75 * drawn["clearance"])
    length = (round(0.295 / drawn["pitch"]) + random.uniform(-0.49, 0.49)) * drawn["pitch"]
    return PAPER.replace(**drawn, switching_threshold=threshold, initial_length=length)
