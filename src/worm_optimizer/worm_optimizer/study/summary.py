# SPDX-License-Identifier: Apache-2.0
"""Summary of a study: its best point, the columns for figures and page, failed points, and Sobol indices."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import xarray
from numpy.typing import NDArray

from worm_optimizer.robustness.sobol import SALTELLI, Indices, indices_of
from worm_optimizer.study.plan import PARAMETER_FILE, Study
from worm_optimizer.study.point import DONE, FAILED, REQUESTS
from worm_optimizer.study.study_run import REASON, STATE, point_table

Array = NDArray[np.float64]

_OPTIMISED = {"at_power_W": "speed", "at_speed_m_s": "power"}  # result that a request optimises
_BETTER = {"at_power_W": "highest", "at_speed_m_s": "lowest"}
_SUCCESS = {
    "success_probability": "success probability",
    "success_probability_any_phase": "success at unknown phase",
}


@dataclass(frozen=True)
class Column:
    """Quantity ``name``, with its value at each point of a table: ``values`` of shape (points,) in ``unit``."""

    name: str
    unit: str
    values: Array


@dataclass(frozen=True)
class Summary:
    """Summary of a study. Columns, ranks and indices refer to the points that were computed without failure.

    Attributes:
        varied: quantities that have more than one value.
        figures: results to show. The first one decides which point is best.
        rank: rank of each of these points, 0 is best.
        best: index of the best point; None if no point has the first result.
        goal: criterion of the best point, as text.
        points: number of all points of the study.
        failed: number of failed points by reason.
        still: number of these points that lack the first result, for example because no gait moves.
    """

    varied: tuple[Column, ...]
    figures: tuple[Column, ...]
    rank: NDArray[np.int64]
    best: int | None
    goal: str
    points: int
    failed: Counter[str]
    still: int


def summarise(output: Path, study: Study) -> Summary:
    """Read the output of a study and return its summary."""
    data = point_table(output)
    state = data[STATE].values
    computed = data.isel(point=np.flatnonzero(state == DONE))
    varied = tuple(
        Column(name, computed[name].attrs.get("units", ""), computed[name].values)
        for name in study.varied
        if name != PARAMETER_FILE and np.unique(computed[name].values).size > 1
    )
    figures, goal = _figures(computed, study)
    key, sign = figures[0].values, (-1.0 if "highest" in goal else 1.0)
    known = np.isfinite(key)
    rank = np.argsort(np.argsort(np.where(known, sign * key, np.inf), kind="stable"))
    return Summary(
        varied=varied,
        figures=figures,
        rank=rank,
        best=int(np.argmin(rank)) if known.any() else None,
        goal=goal,
        points=study.size,
        failed=Counter(map(str, data[REASON].values[state == FAILED])),
        still=int(np.count_nonzero(~known)),
    )


def study_indices(output: Path, study: Study) -> Mapping[str, Indices]:
    """Return the Sobol indices of each result on the study's page, by its name; empty without a Saltelli sample.

    Each sampled quantity is uniformly distributed over its range. The indices of a result are NaN if a point lacks it.
    """
    if not study.ranges or study.sample.method != SALTELLI:
        return {}
    columns, _ = _figures(point_table(output), study)
    inputs = len(study.ranges)
    return {column.name: indices_of(column.values, inputs, study.sample.seed) for column in columns}


def _figures(data: xarray.Dataset, study: Study) -> tuple[tuple[Column, ...], str]:
    """Return the results to show, the one that decides which point is best first, and the goal as text.

    A gait at a fixed power or speed decides; without one, the cruising gait.
    """

    def column(title: str, name: str, gait: str = "") -> Column:
        array = data[name].sel(gait=gait) if gait else data[name]
        values = np.where(np.isfinite(array.values), array.values, np.nan)
        return Column(title, data[name].attrs.get("units", ""), values)

    cliff = "cliff_margin" if "cliff_margin" in data else "closed_form_cliff_margin"
    common = [column(name, name) for name in ("hypervolume", cliff) if name in data]
    prefix = "" if "speed" in data else "any_phase_"
    if f"{prefix}speed" not in data:
        front = "the front with the highest hypervolume"
        return tuple(common), front if "hypervolume" in data else "the highest margin at the cliff"
    named = [key for key in REQUESTS if key in (*study.fixed, *study.varied)]
    named.sort(key=lambda key: key not in study.fixed)
    requested = [
        column(
            f"{_OPTIMISED[key]} at {_value(study, key)}",
            f"{prefix}{_OPTIMISED[key]}",
            REQUESTS[key].name.lower(),
        )
        for key in named
    ]
    cost = f"{prefix}cost_of_transport"
    if named and named[0] in study.fixed:
        gait, at = REQUESTS[named[0]].name.lower(), _value(study, named[0])
        shown = [requested[0], column(f"cost of transport at {at}", cost, gait), *requested[1:]]
        goal = f"the {_BETTER[named[0]]} {requested[0].name}"
    else:
        gait = "cruise"
        speed = column("cruising speed", f"{prefix}speed", gait)
        shown = [column("cost of transport", cost, gait), speed, *requested]
        goal = "the lowest cost of transport of the cruising gait"
    success = [column(title, name, gait) for name, title in _SUCCESS.items() if name in data]
    return (*shown, *success, *common), goal


def _value(study: Study, key: str) -> str:
    """Return the fixed power or speed of a request as text."""
    if key not in study.fixed:
        return f"each {key}"
    if key == "at_power_W":
        return f"{study.fixed[key]:.3g} W"
    return f"{1e3 * study.fixed[key]:.3g} mm/s"
