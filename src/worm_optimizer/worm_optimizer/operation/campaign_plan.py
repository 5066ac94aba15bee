# SPDX-License-Identifier: Apache-2.0
"""Plan of a campaign: its gaits with their predictions, which are written to a file before the first run."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from worm_model.commands.command_line import finite
from worm_model.gait import named_values
from worm_model.parameters import ParameterFile
from worm_msgs.conditions import LEVEL
from worm_optimizer.gait_prediction import Prediction
from worm_optimizer.report.agreement import LEVEL_GROUND, NOMINAL, SINUSOIDAL
from worm_optimizer.report.optimisation import Optimisation
from worm_optimizer.search.front import (
    make_front,
    nominal_gaits,
    predicted_gaits,
    reason_for,
    scanned_price,
)
from worm_optimizer.search.search_settings import Settings, Waveform

PROMISES = "promised.json"  # name of the file with the predictions of a campaign


@dataclass(frozen=True)
class Plan:
    """Predictions of the gaits by name, in the order of the runs, and the front with its price of robustness."""

    gaits: Mapping[str, Prediction]
    optimisation: Optimisation


def make_plan(content: ParameterFile, settings: Settings, direction: int) -> Plan:
    """Return a plan with the minimum-power, cruising and maximum-speed gaits of the front.

    Args:
        content: parameters of the robot.
        settings: settings of the search. If the criterion is the margin and they contain none, the last margin before
            the cliff is used.
        direction: FORWARD or REVERSE.

    Raises:
        OptimizerError: No gait moves.
    """
    price = scanned_price(content, settings, direction)
    if settings.scans_margins:  # the scan is not repeated
        front = make_front(content, settings.with_margin(price.margin), direction)
        front = replace(front, reason=reason_for(price))
    else:
        front = make_front(content, settings, direction)
    return Plan(front.three, Optimisation(front, price))


def with_comparisons(
    plan: Plan, content: ParameterFile, settings: Settings, direction: int, *, nominal: bool
) -> Plan:
    """Return a plan in which each of the three gaits is followed by gaits with which it is compared.

    Under conditions other than level ground, each gait is compared with the corresponding gait that is designed for
    level ground. In a plan of shaped gaits, each gait is compared with the corresponding sinusoid. These gaits are
    designed with the plan's criterion of robustness. If this is the margin, they have the same margin as the plan.

    Args:
        plan: plan with three gaits.
        content, settings, direction: the arguments of `make_plan`.
        nominal: True to compare each gait also with the corresponding gait that is designed without a margin.

    Raises:
        OptimizerError: No gait moves on level ground, or no sinusoid moves.
    """
    settings = settings.with_margin(plan.optimisation.front.margin)
    compared: dict[str, Mapping[str, Prediction]] = {}
    if nominal:
        compared[NOMINAL] = nominal_gaits(content, settings, direction)
    if settings.conditions != LEVEL:
        level = make_front(content, replace(settings, conditions=LEVEL), direction)
        compared[LEVEL_GROUND] = predicted_gaits(level.three, content, settings)
    if settings.waveform is Waveform.SHAPED:
        sinusoid = replace(settings, waveform=Waveform.SINUSOID)
        compared[SINUSOIDAL] = make_front(content, sinusoid, direction).three
    gaits = {
        prefix + name: group[name]
        for name in plan.gaits
        for prefix, group in {"": plan.gaits, **compared}.items()
    }
    return replace(plan, gaits=gaits)


def write_promises(plan: Plan, folder: Path) -> Path:
    """Write the predictions to a new file and return its path.

    The file proves that the predictions were not adapted to the runs.

    Raises:
        FileExistsError: The folder already contains such a file.
    """
    path = folder / PROMISES
    with path.open("x", encoding="utf-8") as file:
        file.write(_promises(plan))
    return path


def is_promised(plan: Plan, folder: Path) -> bool:
    """Return True if the file of predictions in a folder is that of this plan. Raises `OSError` if it is missing."""
    return (folder / PROMISES).read_text(encoding="utf-8") == _promises(plan)


def _promises(plan: Plan) -> str:
    content = {name: named_values(gait) for name, gait in plan.gaits.items()}
    return json.dumps(finite(content), allow_nan=False, indent=2)
