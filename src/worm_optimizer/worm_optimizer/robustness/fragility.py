# SPDX-License-Identifier: Apache-2.0
"""The paper's claim as a table: nominal optima are fragile, robust ones are not."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from worm_model.parameters import ParameterFile
from worm_model.simulation.simulator import cost_of_transport
from worm_optimizer.robustness.prediction import Prediction, predict
from worm_optimizer.search.front import task_of
from worm_optimizer.search.gait_map import build_map
from worm_optimizer.search.search_settings import Settings


def nominal_gaits(
    content: ParameterFile, settings: Settings, direction: int
) -> dict[str, Prediction]:
    """The three gaits of the true front without any margin, by name; none if no gait moves."""
    task = task_of(content, settings, direction)
    front = build_map(task, settings.map).front
    if not len(front):
        return {}
    cost = cost_of_transport(front.speed, front.power, content.parameters.mass)
    rows = [int(np.argmin(front.power)), int(np.argmin(cost)), int(np.argmax(front.speed))]
    gaits = front.stroke[rows], front.frequency[rows], np.zeros(len(rows))
    told = predict(task, content, *gaits, settings.samples, settings.search.seed)
    return dict(zip(("min_power", "cruise", "max_speed"), told, strict=True))


def table(robust: Mapping[str, Prediction], nominal: Mapping[str, Prediction]) -> str:
    """Both sets of gaits side by side, one line each."""
    header = (
        f"{'gait':<20} {'S':>6} {'f':>7} {'margin':>6} {'speed':>7} {'nominal':>7} {'power':>6} {'COT':>6}"
        f" {'n':>4} {'to edges':>11} {'success':>8} {'any φ':>6}\n"
        f"{'':<20} {'mm':>6} {'Hz':>7} {'mm':>6} {'mm/s':>7} {'mm/s':>7} {'W':>6} {'1':>6}"
        f" {'1':>4} {'mm':>11} {'1':>8} {'1':>6}"
    )
    lines = [header]
    for kind, gaits in (("robust", robust), ("nominal", nominal)):
        lines += [_line(f"{kind} {name.replace('_', ' ')}", gait) for name, gait in gaits.items()]
    return "\n".join(lines)


def _line(name: str, gait: Prediction) -> str:
    edges = f"-{1e3 * gait.stroke_to_lower_edge:.1f} +{1e3 * gait.stroke_to_upper_edge:.1f}"
    return (
        f"{name:<20} {1e3 * gait.stroke:6.2f} {gait.frequency:7.4f} {1e3 * gait.margin:6.2f}"
        f" {1e3 * gait.speed:7.3f} {1e3 * gait.nominal_speed:7.3f} {gait.power:6.3f}"
        f" {gait.cost_of_transport:6.1f} {gait.grooves_per_cycle:4.2f} {edges:>11}"
        f" {gait.success_probability:8.3f} {gait.success_probability_any_phase:6.3f}"
    )
