# SPDX-License-Identifier: Apache-2.0
"""How the figures of a report look: colours that colour-blind readers can tell apart, and a line style a role."""

from __future__ import annotations

from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

# Okabe and Ito's palette.
BLUE, VERMILION, GREEN, GREY = "#0072B2", "#D55E00", "#009E73", "#999999"
BLACK, PURPLE = (
    "#000000",
    "#5D3A9B",
)  # on top of the front, whose branches have the palette's colours
MEASURED: dict[str, Any] = {"color": BLUE, "linewidth": 1.5}
PREDICTED: dict[str, Any] = {"color": VERMILION, "linewidth": 1.5, "linestyle": "--"}
COMMANDED: dict[str, Any] = {"color": "#C8C8C8", "linewidth": 4.0}  # broad: others lie on it
CABLE: dict[str, Any] = {"color": BLACK, "linewidth": 0.8}
EFFECTIVE: dict[str, Any] = {"color": GREEN, "linewidth": 1.5, "linestyle": "-."}
_AVERAGED = "#FFF3CF"  # behind the averaged cycles


def new_figure(width: float, height: float) -> Figure:
    """A figure of a size in inches."""
    return Figure(figsize=(width, height), layout="constrained")


def finish(axes: Axes, ylabel: str) -> None:
    """Grid, unit, and the legend in a row above the axes, where it hides nothing."""
    axes.set_ylabel(ylabel)
    axes.grid(visible=True, linewidth=0.4)
    axes.margins(x=0.01)
    handles, _ = axes.get_legend_handles_labels()
    if handles:
        axes.legend(
            loc="lower left",
            bbox_to_anchor=(0.0, 0.98),
            ncols=len(handles),
            fontsize="small",
            frameon=False,
            handlelength=2.6,
            columnspacing=1.4,
        )


def shade(axes: Axes, start: float, end: float, label: str = "averaged cycles") -> None:
    """Marks the averaged cycles."""
    axes.axvspan(start, end, color=_AVERAGED, zorder=0, label=label or None)
