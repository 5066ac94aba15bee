# SPDX-License-Identifier: Apache-2.0
"""What a campaign is going to run, and what is promised of it before anything moves."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from worm_model.parameters import ParameterFile
from worm_optimizer.report.agreement import NOMINAL
from worm_optimizer.report.optimisation import Optimisation
from worm_optimizer.robustness.prediction import Prediction
from worm_optimizer.search.cache import Cache
from worm_optimizer.search.front import Report, load_front, make_front, nominal_gaits, scanned_price
from worm_optimizer.search.gait_request import three_gaits
from worm_optimizer.search.search_settings import Settings

PROMISES = "promised.json"


@dataclass(frozen=True)
class Plan:
    """``gaits`` by name in the order of the runs, and the front that they come from."""

    gaits: Mapping[str, Prediction]
    optimisation: Optimisation


def make_plan(
    content: ParameterFile, settings: Settings, direction: int, cache: Cache, report: Report
) -> Plan:
    """Minimum-power, cruising and maximum-speed gaits of the front that the settings make, from the cache if there.

    Raises `OptimizerError` if no gait moves.
    """
    price = scanned_price(content, settings, direction, cache, report)
    front = load_front(content, settings, direction, cache)
    if front is None:
        front = make_front(content, settings, direction, cache, report)
    return Plan(three_gaits(front.predictions), Optimisation(front, price))


def beside_nominal(plan: Plan, content: ParameterFile, settings: Settings, direction: int) -> Plan:
    """The plan, and after each gait the one that is best without any margin."""
    nominal = nominal_gaits(content, settings, direction)
    gaits = {
        each: gait
        for name, robust in plan.gaits.items()
        for each, gait in ((name, robust), (NOMINAL + name, nominal[name]))
    }
    return replace(plan, gaits=gaits)


def write_promises(plan: Plan, folder: Path) -> Path:
    """Writes down what is predicted, so that nobody can say that it was known afterwards."""
    path = folder / PROMISES
    with path.open("x", encoding="utf-8") as file:
        file.write(_promises(plan))
    return path


def is_promised(plan: Plan, folder: Path) -> bool:
    """Whether a folder was begun with just this plan. Raises OSError where it holds none."""
    return (folder / PROMISES).read_text(encoding="utf-8") == _promises(plan)


def _promises(plan: Plan) -> str:
    return json.dumps({name: asdict(gait) for name, gait in plan.gaits.items()}, indent=2)
