# SPDX-License-Identifier: Apache-2.0
"""Plan of a campaign: its gaits with their predictions, which a file promises, and how the repeats keep them."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from worm_model.analysis.plot_style import BLUE, VERMILION, finish, new_figure, save_figure
from worm_model.commands.command_line import finite
from worm_model.errors import InputError
from worm_model.gait import named_values
from worm_model.parameters import ParameterFile
from worm_model.text_table import text_table
from worm_msgs.conditions import LEVEL
from worm_optimizer.gait_prediction import Prediction
from worm_optimizer.report.agreement import (
    COMPARED,
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

_WIDTH = 0.3  # half the length of a prediction's line; neighbouring gaits are 1 apart
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


@dataclass(frozen=True)
class Spread:
    """Statistics of the repeats of one gait.

    Attributes:
        name: name of the gait.
        repeats: number of repeats.
        promised: predicted grooves per cycle.
        kept: number of repeats that gained the predicted grooves in every averaged cycle.
        means: mean of each quantity, by name, SI units.
        deviations: standard deviation of each quantity, by name, SI units; NaN for a single repeat.
        speeds: speed of each repeat, m/s.
        promised_speed: predicted speed with the margin, m/s.
    """

    name: str
    repeats: int
    promised: int
    kept: int
    means: Mapping[str, float]
    deviations: Mapping[str, float]
    speeds: tuple[float, ...]
    promised_speed: float


def run_names(gaits: Sequence[str], repeats: int) -> dict[str, str]:
    """Return a mapping from the name of each run to the name of its gait, in the order of the runs.

    Each repeat runs all gaits once, so that the repeats of one gait do not follow each other directly.
    """
    if repeats == 1:
        return {name: name for name in gaits}
    return {f"{name}_{k}": name for k in range(1, repeats + 1) for name in gaits}


def spread(name: str, promise: Prediction, runs: Sequence[RecordedGait]) -> Spread:
    """Return the statistics of the repeats of one gait.

    Args:
        name: name of the gait.
        promise: prediction of the gait before the runs.
        runs: the recorded repeats, at least one.
    """
    pitch = runs[0].content.parameters.pitch
    promised = round(promise.grooves_per_cycle)
    values = {
        quantity: np.array([getattr(run.measured, quantity).value for run in runs])
        for quantity in QUANTITIES
    }
    poorest = [run.measured.speed.low / (pitch * run.gait.frequency) for run in runs]
    return Spread(
        name=name,
        repeats=len(runs),
        promised=promised,
        kept=sum(grooves > promised - 0.5 for grooves in poorest),
        means={quantity: float(np.mean(measured)) for quantity, measured in values.items()},
        deviations={
            quantity: float(np.std(measured, ddof=1)) if len(runs) > 1 else math.nan
            for quantity, measured in values.items()
        },
        speeds=tuple(values["speed"].tolist()),
        promised_speed=promise.speed,
    )


def spread_table(spreads: Sequence[Spread]) -> str:
    """Return a text table with a row for each gait.

    It contains the number of repeats that gained the predicted grooves, and mean ± standard deviation of each quantity.
    """
    rows = [("gait", "grooves as predicted", *(quantity.title for quantity in QUANTITIES.values()))]
    for row in spreads:
        kept = f"{row.kept} of {row.repeats} ({row.promised} a cycle)"
        cells = (
            f"{quantity.text(row.means[key])} ± {quantity.text(row.deviations[key])}"
            for key, quantity in QUANTITIES.items()
        )
        rows.append((title_of(row.name), kept, *cells))
    return text_table(rows)


def draw_spread(path: Path, spreads: Sequence[Spread]) -> None:
    """Write the figure of the speeds: a dot for each repeat, and a line for the prediction with the margin."""
    figure = new_figure(1.6 + 1.3 * len(spreads), 3.6)
    axes = figure.add_subplot()
    for place, row in enumerate(spreads):
        color = VERMILION if row.name.startswith(tuple(COMPARED)) else BLUE
        aside = np.linspace(-_WIDTH / 2, _WIDTH / 2, row.repeats) if row.repeats > 1 else [0.0]
        axes.plot(place + np.asarray(aside), 1e3 * np.array(row.speeds), "o", color=color)
        level = 1e3 * row.promised_speed
        axes.plot([place - _WIDTH, place + _WIDTH], [level, level], color="black", linewidth=1.2)
    axes.set_xticks(
        range(len(spreads)),
        [
            f"{title_of(row.name).replace(', ', chr(10))}\n{row.kept} of {row.repeats} as predicted"
            for row in spreads
        ],
    )
    axes.set_ylim(bottom=0.0)
    finish(axes, "speed (mm/s)", "line: prediction with the margin; dot: one run")
    save_figure(figure, path)
