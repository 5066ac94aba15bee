# SPDX-License-Identifier: Apache-2.0
"""Summary of a study: its best point, the columns for figures and page, and the failed points."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import xarray
from numpy.typing import NDArray

from worm_msgs.conditions import CONDITION_ROWS
from worm_optimizer.study.plan import PARAMETER_FILE, Study
from worm_optimizer.study.point import DONE, FAILED, OPEN, REQUESTS, gait_names
from worm_optimizer.study.results import point_table

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Column:
    """Quantity ``name``, with its value at each point of a table: ``values`` of shape (points,) in ``unit``."""

    name: str
    unit: str
    values: Array


@dataclass(frozen=True)
class Summary:
    """Summary of a study. Columns, ranks, indices and ``still`` refer to the points that were computed without failure.

    Attributes:
        varied: quantities that have more than one value.
        figures: results to show. The first one decides which point is best.
        rank: rank of each of these points, 0 is best.
        best: index of the best point; None if no point has the first result.
        own: index of the point with the values of the parameter file; None if there is no such point.
        goal: criterion of the best point, as text.
        points: number of all points of the study.
        done: number of finished points, including failed ones.
        failed: number of failed points by reason.
        still: number of these points that lack the first result, for example because no gait moves.
    """

    varied: tuple[Column, ...]
    figures: tuple[Column, ...]
    rank: NDArray[np.int64]
    best: int | None
    own: int | None
    goal: str
    points: int
    done: int
    failed: Counter[str]
    still: int


def summarise(path: Path, study: Study) -> Summary:
    """Read the output of a study and return its summary."""
    with point_table(path) as data:
        state = data["state"].values
        done = np.flatnonzero(state == DONE)
        computed = data.isel(point=done).load()
        reasons = data["reason"].isel(point=np.flatnonzero(state == FAILED)).values
    varied = tuple(
        Column(name, computed[name].attrs.get("units", ""), computed[name].values)
        for name in study.varied
        if name != PARAMETER_FILE and np.unique(computed[name].values).size > 1
    )
    figures, goal = figures_of(computed, study)
    key, sign = figures[0].values, (-1.0 if "highest" in goal else 1.0)
    known = np.isfinite(key)
    rank = np.argsort(np.argsort(np.where(known, sign * key, np.inf), kind="stable"))
    return Summary(
        varied=varied,
        figures=figures,
        rank=rank,
        best=int(np.argmin(rank)) if known.any() else None,
        own=_own(varied, study),
        goal=goal,
        points=study.size,
        done=int(np.count_nonzero(state != OPEN)),
        failed=Counter(str(reason) for reason in reasons),
        still=int(done.size - np.count_nonzero(known)),
    )


def _own(varied: tuple[Column, ...], study: Study) -> int | None:
    """Return the index of the point with the values of the parameter file.

    Return None if there are several files, a varied quantity is no parameter, no point has these values, or a fixed
    parameter, condition or groove phase makes the robot of every point another one.
    """
    values = study.files[0][1].parameters.as_dict()
    if len(study.files) > 1 or not all(column.name in values for column in varied):
        return None
    usual = {**values, **dict.fromkeys(CONDITION_ROWS, 0.0)}
    if "groove_phase_m" in study.fixed or any(
        not np.isclose(value, usual[name], rtol=1e-9)
        for name, value in study.fixed.items()
        if name in usual
    ):
        return None
    same = [np.isclose(column.values, values[column.name], rtol=1e-9) for column in varied]
    rows = np.flatnonzero(np.all(same, axis=0)) if same else np.empty(0)
    return int(rows[0]) if rows.size else None


def figures_of(data: xarray.Dataset, study: Study) -> tuple[tuple[Column, ...], str]:
    """Return the results to show, the one that decides which point is best first, and the goal as text."""

    def column(name: str, gait: str = "", title: str = "") -> Column:
        array = data[name].sel(gait=gait) if gait else data[name]
        values = np.where(np.isfinite(array.values), array.values, np.nan)
        return Column(title or name, data[name].attrs.get("units", ""), values)

    prefix = "" if "speed" in data else "any_phase_"
    cliff = [column("cliff_margin" if "cliff_margin" in data else "closed_form_cliff_margin")]
    front = [column("hypervolume")] if "hypervolume" in data else []
    if f"{prefix}speed" not in data and front:
        return (*front, *cliff), "the front with the highest hypervolume"
    if f"{prefix}speed" not in data:
        return (cliff[0],), "the highest margin at the cliff"
    wanted = [key for key in REQUESTS if REQUESTS[key].name.lower() in gait_names(study)]
    if wanted == ["at_power_W"] and "at_power_W" in study.fixed:
        watts = f"{study.fixed['at_power_W']:.3g}"
        fastest = column(f"{prefix}speed", "max_speed_at_power", f"speed at {watts} W")
        cost = column(
            f"{prefix}cost_of_transport", "max_speed_at_power", f"cost of transport at {watts} W"
        )
        return (fastest, cost, *front, *cliff), f"the highest speed at {watts} W"
    cost = column(f"{prefix}cost_of_transport", "cruise", "cost of transport")
    speed = column(f"{prefix}speed", "cruise", "cruising speed")
    return (cost, speed, *front, *cliff), "the lowest cost of transport of the cruising gait"
