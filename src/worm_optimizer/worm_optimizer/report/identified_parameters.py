# SPDX-License-Identifier: Apache-2.0
"""Table and figure of identified parameters, compared with the paper's values."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from matplotlib.figure import Figure

from worm_model.analysis.plot_style import BLUE, GREY, new_figure, symbol
from worm_model.parameters import FITTED_WITH_FORM, KEYS, PAPER, SYMBOLS, UNITS, ParameterFile


def parameter_rows(content: ParameterFile) -> Iterator[tuple[str, ...]]:
    """Yield key, symbol, value, interval, paper's value and unit of each parameter."""
    values, paper = content.parameters.as_dict(), PAPER.as_dict()
    alike = comparable_with_paper(content)
    for key in KEYS:
        low, high = content.intervals.get(key, (math.nan, math.nan))
        interval = f"{low:.5g} to {high:.5g}" if math.isfinite(low) else "not identified"
        text = f"{paper[key]:.5g}" if key in alike else "–"
        yield key, SYMBOLS[key], f"{values[key]:.5g}", interval, text, UNITS[key]


def comparable_with_paper(content: ParameterFile) -> list[str]:
    """Return the keys of the parameters that are comparable with the paper.

    Parameters that were fitted with a power model other than the paper's are omitted.
    """
    other = FITTED_WITH_FORM if content.parameters.one_sided_cable else ()
    return [key for key in KEYS if key not in other]


def parameters_figure(content: ParameterFile) -> Figure:
    """Draw the ratio of each identified parameter to the paper's value, with its 95 % interval.

    Parameters that are 0 in the paper or not comparable with it (`comparable_with_paper`) are omitted.
    """
    values, paper = content.parameters.as_dict(), PAPER.as_dict()
    keys = [
        key for key in comparable_with_paper(content) if key in content.intervals and paper[key]
    ]
    ratio = np.array([values[key] / paper[key] for key in keys])
    ends = [np.divide(content.intervals[key], paper[key]) for key in keys]
    bounds = np.reshape(ends, (len(keys), 2))
    figure = new_figure(8.0, 1.2 + 0.32 * len(keys))
    axes = figure.subplots()
    rows = np.arange(len(keys))
    axes.axvline(1.0, color=GREY, linestyle="--", label="the paper's value")
    axes.errorbar(
        ratio,
        rows,
        xerr=[np.maximum(ratio - bounds[:, 0], 0.0), np.maximum(bounds[:, 1] - ratio, 0.0)],
        color=BLUE,
        marker="o",
        linestyle="none",
        capsize=4,
        label="identified, 95 %",
    )
    axes.set_yticks(rows, [f"{key} ({symbol(SYMBOLS[key])})" for key in keys])
    axes.invert_yaxis()
    axes.set_xlabel("identified value / paper's value (1)")
    axes.grid(visible=True, axis="x", linewidth=0.4)
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, frameon=False)
    return figure
