# SPDX-License-Identifier: Apache-2.0
"""Identified parameters against the paper's, with their intervals."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from worm_model.parameters import PAPER, SYMBOLS, ParameterFile
from worm_optimizer.report.style import BLUE, GREY, new_figure


def draw_parameters(content: ParameterFile) -> Figure:
    """Each parameter that has an interval, as a ratio to the paper's value."""
    values, paper = content.parameters.as_dict(), PAPER.as_dict()
    keys = [key for key in values if key in content.intervals]
    ratio = np.array([values[key] / paper[key] for key in keys])
    bounds = np.array([content.intervals[key] for key in keys]) / np.array(
        [[paper[key]] for key in keys]
    )
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
    axes.set_yticks(rows, [f"{key} ({SYMBOLS[key]})" for key in keys])
    axes.invert_yaxis()
    axes.set_xlabel("value over the paper's (1)")
    axes.grid(visible=True, axis="x", linewidth=0.4)
    axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2, frameon=False)
    return figure
