# SPDX-License-Identifier: Apache-2.0
"""HTML page of a table of many bags (`study --bags`).

It contains measured and expected values, parameters that drift, and bags that could not be used.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pyarrow.parquet as parquet

from worm_model.identification.drift import ADVICE, Chart, State, chart_of
from worm_model.identification.fits.estimate import Estimate
from worm_model.identification.report.drift_figure import draw_health
from worm_model.parameters import ParameterFile, load_parameter_file
from worm_optimizer.study.fleet import FAILED, Row
from worm_optimizer.study.study_page import Table, render
from worm_optimizer.study.study_plots import Picture, compared_figure, png


def write_fleet_page(table: Path, parameters: str, page: Path) -> None:
    """Write the page of a table of many bags (`study --bags`).

    The limits of the control charts come from the intervals in the parameter file ``parameters``. For a parameter
    without an interval, they come from the bags.

    Raises:
        FileExistsError: The page exists already.
    """
    rows = parquet.read_table(table).to_pylist()
    read = sorted(
        (row for row in rows if row["state"] != FAILED), key=lambda row: str(row["start"])
    )
    failed = [row for row in rows if row["state"] == FAILED]
    charts, names = fleet_charts(read, load_parameter_file(parameters))
    images = []
    if read:
        caption = (
            "Measured values (vertical) against the values that the model expects from the command (horizontal), "
            "one point for each gait."
        )
        images.append(Picture(png(compared_figure(read)), caption))
    if names:
        caption = "Parameters estimated from each bag alone, in the order of time."
        images.append(Picture(_health(names, charts), caption))
    render(
        page,
        title="Fleet",
        lead=_lead(rows, failed, charts),
        tables=[_gaits_table(read), *_failed_table(failed)],
        images=images,
        limits=[],
        sources=[],
    )


def fleet_charts(read: Sequence[Row], known: ParameterFile) -> tuple[list[Chart], list[str]]:
    """Return a control chart of each key of `drift.ADVICE`, and the names of the bags in the charts.

    The charts contain the bags from which at least one of these parameters was estimated. See `drift.chart_of`.

    Args:
        read: rows of the gaits, in the order of time.
        known: parameters whose intervals determine the limits.
    """
    bags = {row["bag"]: row for row in read if any(math.isfinite(row[key]) for key in ADVICE)}
    charts = [
        chart_of(key, [_estimate(row, key) for row in bags.values()], known) for key in ADVICE
    ]
    return charts, list(bags)


def _estimate(row: Row, key: str) -> Estimate:
    value = row[key]
    return Estimate(value, row[f"{key}_low"], row[f"{key}_high"], math.isfinite(value), "")


def _health(names: Sequence[str], charts: Sequence[Chart]) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "health.png"
        draw_health(names, charts, file)
        return file.read_bytes()


def _lead(rows: Sequence[Row], failed: Sequence[Row], charts: Sequence[Chart]) -> list[str]:
    bags = {row["bag"] for row in rows}
    lines = [
        f"{len(bags)} bags, {len(rows) - len(failed)} gaits; {len(failed)} bags could not be used."
    ]
    for chart in charts:
        if chart.state not in (State.WITHIN, State.TOO_FEW):
            lines.append(f"{chart.key}: {chart.state.value}; {chart.advice}.")
    few = [chart.key for chart in charts if chart.state is State.TOO_FEW]
    if few:
        lines.append(f"Too few bags for control limits of {', '.join(few)}.")
    return lines


def _gaits_table(read: Sequence[Row]) -> Table:
    heads = (
        *("gait", "start", "S (mm)", "f (Hz)", "speed (mm/s)", "expected"),
        *("power (W)", "expected", "COT", "events"),
    )
    return Table("Gaits", heads, [_cells(row) for row in read])


def _cells(row: Row) -> list[str]:
    def text(value: Any, scale: float = 1.0, digits: int = 3) -> str:
        return f"{scale * value:.{digits}f}" if math.isfinite(value) else "–"

    return [
        *(str(row["gait"]), str(row["start"])[:19]),
        *(text(row["stroke_m"], 1e3, 1), text(row["frequency_Hz"], digits=4)),
        *(text(row["speed_m_s"], 1e3), text(row["expected_speed_m_s"], 1e3)),
        *(text(row["power_W"]), text(row["expected_power_W"])),
        *(text(row["cost_of_transport"], digits=1), text(row["events"], digits=0)),
    ]


def _failed_table(failed: Sequence[Row]) -> list[Table]:
    if not failed:
        return []
    rows = [[str(row["bag"]), str(row["reason"])] for row in failed]
    return [Table("Bags that could not be used", ("bag", "reason"), rows, words=True)]
