# SPDX-License-Identifier: Apache-2.0
"""Plan of a campaign: its gaits with their predictions, which a file promises, and how the repeats keep them."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from worm_model.commands.command_line import finite
from worm_model.errors import InputError
from worm_model.gait import named_values
from worm_model.parameters import ParameterFile
from worm_model.text_table import text_table
from worm_msgs.conditions import LEVEL
from worm_optimizer.gait_prediction import Prediction
from worm_optimizer.report.agreement import (
    LEVEL_GROUND,
    NOMINAL,
    QUANTITIES,
    SINUSOIDAL,
    title_of,
)
from worm_optimizer.report.optimisation import Optimisation
from worm_optimizer.report.recorded_gait import RecordedGait
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


def make_plan(
    content: ParameterFile, settings: Settings, direction: int, *, nominal: bool = False
) -> Plan:
    """Return a plan with the minimum-power, cruising and maximum-speed gaits of the front.

    Each of them is followed by the gaits with which it is compared: under conditions other than level ground, the
    corresponding gait that is designed for level ground; in a plan of shaped gaits, the corresponding sinusoid. These
    gaits are designed with the plan's criterion of robustness. If this is the margin, they have the same margin.

    Args:
        content: parameters of the robot.
        settings: settings of the search. If the criterion is the margin and they contain none, the last margin before
            the cliff is used.
        direction: FORWARD or REVERSE.
        nominal: True to compare each gait also with the corresponding gait that is designed without a margin.
    """
    price = scanned_price(content, settings, direction)
    if settings.scans_margins:  # the scan is not repeated
        front = make_front(content, settings.with_margin(price.margin), direction)
        front = replace(front, reason=reason_for(price))
    else:
        front = make_front(content, settings, direction)
    settings = settings.with_margin(front.margin)
    compared: dict[str, Mapping[str, Prediction]] = {"": front.three}
    if nominal:
        compared[NOMINAL] = nominal_gaits(content, settings, direction)
    if settings.conditions != LEVEL:
        level = make_front(content, replace(settings, conditions=LEVEL), direction)
        compared[LEVEL_GROUND] = predicted_gaits(level.three, content, settings)
    if settings.waveform is Waveform.SHAPED:
        sinusoid = replace(settings, waveform=Waveform.SINUSOID)
        compared[SINUSOIDAL] = make_front(content, sinusoid, direction).three
    gaits = {
        prefix + name: group[name] for name in front.three for prefix, group in compared.items()
    }
    return Plan(gaits, Optimisation(front, price))


def promise(plan: Plan, folder: Path) -> None:
    """Write the predictions to a new file in a folder, which proves that they were not adapted to the runs."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / PROMISES
    if not path.exists():
        path.write_text(_promises(plan), encoding="utf-8")
    elif path.read_text(encoding="utf-8") != _promises(plan):
        raise InputError(
            f"{folder}: this campaign has other predictions: use the options of its start again"
        )


def _promises(plan: Plan) -> str:
    content = {name: named_values(gait) for name, gait in plan.gaits.items()}
    return json.dumps(finite(content), allow_nan=False, indent=2)


def run_names(gaits: Sequence[str], repeats: int) -> dict[str, str]:
    """Return a mapping from the name of each run to the name of its gait, in the order of the runs.

    Each repeat runs all gaits once, so that the repeats of one gait do not follow each other directly.
    """
    if repeats == 1:
        return {name: name for name in gaits}
    return {f"{name}_{k}": name for k in range(1, repeats + 1) for name in gaits}


def spread_table(
    promises: Mapping[str, Prediction], runs: Mapping[str, Sequence[RecordedGait]]
) -> str:
    """Return a text table with a row for each gait.

    It contains the number of repeats that gained the predicted grooves in every averaged cycle, and mean ± standard
    deviation (NaN for a single repeat) of each quantity.

    Args:
        promises: prediction of each gait before the runs, by name.
        runs: recorded repeats of each gait, at least one, by name.
    """
    rows = [("gait", "grooves as predicted", *(quantity.title for quantity in QUANTITIES.values()))]
    for name, promise in promises.items():
        repeats, promised = runs[name], round(promise.grooves_per_cycle)
        pitch = repeats[0].content.parameters.pitch
        poorest = [run.measured.speed.low / (pitch * run.gait.frequency) for run in repeats]
        kept = sum(grooves > promised - 0.5 for grooves in poorest)
        cells = [title_of(name), f"{kept} of {len(repeats)} ({promised} a cycle)"]
        for key, quantity in QUANTITIES.items():
            values = [getattr(run.measured, key).value for run in repeats]
            deviation = float(np.std(values, ddof=1)) if len(values) > 1 else math.nan
            cells.append(f"{quantity.text(float(np.mean(values)))} ± {quantity.text(deviation)}")
        rows.append(tuple(cells))
    return text_table(rows)
