# SPDX-License-Identifier: Apache-2.0
"""Common style of all figures: colours for colour-blind readers, line styles by role, panels, files.

Nothing here imports pyplot, so that figures need neither global state nor a display.
"""

from __future__ import annotations

import string
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure

# Okabe and Ito's palette (https://jfly.uni-koeln.de/color), and further colours that contrast with it
BLUE, VERMILION, GREEN, PINK, SKY, ORANGE = (
    "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00",
)  # fmt: skip
BLACK, GREY, LIGHT_GREY, PURPLE = "#000000", "#999999", "#D0D0D0", "#5D3A9B"
CYCLE = (BLUE, VERMILION, GREEN, PINK, SKY, ORANGE)
MARKERS = ("o", "s", "^", "D", "v", "P")

Style = Mapping[str, Any]
MEASURED: Style = {"color": BLUE, "linewidth": 1.5}
SAMPLES: Style = {"color": BLUE, "linestyle": "none", "marker": ".", "markersize": 3}
PREDICTED: Style = {"color": VERMILION, "linewidth": 1.5, "linestyle": "--"}
COMMANDED: Style = {"color": LIGHT_GREY, "linewidth": 4.0}  # wide, to be visible behind others
CABLE: Style = {"color": BLACK, "linewidth": 0.8}
EFFECTIVE: Style = {"color": GREEN, "linewidth": 1.5, "linestyle": "-."}
_AVERAGED = "#FFF3CF"  # background of the averaged cycles

DPI = 150
MM = 1e3  # mm per m
MARGIN_SYMBOL = r"$\delta_\mathrm{m}$"

_UNDATED: Mapping[str, dict[str, None]] = {  # so that equal data produce equal bytes
    ".pdf": {"CreationDate": None},
    ".svg": {"Date": None},
}


def new_figure(width: float, height: float) -> Figure:
    """Return a figure of a size in inches with constrained layout."""
    return Figure(figsize=(width, height), layout="constrained")


def save_figure(figure: Figure, path: Path) -> None:
    """Write a figure in the format of the name's ending."""
    with mpl.rc_context({"svg.hashsalt": "worm"}):
        figure.savefig(path, dpi=DPI, metadata=_UNDATED.get(path.suffix.lower()))


def save_png_and_pdf(figure: Figure, stem: Path) -> None:
    """Write a figure to ``stem``.png and ``stem``.pdf, both with the layout of the first file.

    Computing the layout takes a third of the time of a file.
    """
    save_figure(figure, Path(f"{stem}.png"))
    figure.set_layout_engine("none")
    save_figure(figure, Path(f"{stem}.pdf"))


def symbol(text: str) -> str:
    """Return a symbol such as ``p_sw`` for a label, with its index as a subscript."""
    base, _, index = text.partition("_")
    return rf"${base}_\mathrm{{{index}}}$" if index else text


COMMANDED_INPUT, EFFECTIVE_INPUT = f"commanded {symbol('u_cmd')}", f"effective {symbol('u_eff')}"


def finish(axes: Axes, ylabel: str, note: str = "") -> None:
    """Set the y label, the grid, a note above the axes on the left, and the legend above the axes on the right.

    With a note, a row of the legend has at most three entries, so that note and legend fit next to each other.
    """
    axes.set_ylabel(ylabel)
    axes.grid(visible=True, linewidth=0.4)
    axes.set_axisbelow(True)
    axes.margins(x=0.01)
    if note:
        axes.set_title(note, loc="left", fontsize="small")
    legend_above(axes, 3 if note else 5)


def legend_above(axes: Axes, columns: int = 5) -> None:
    """Put the legend above the axes, with at most ``columns`` entries per row; no legend if no curve has a label."""
    handles, _ = axes.get_legend_handles_labels()
    if handles:
        axes.legend(
            loc="lower right",
            bbox_to_anchor=(1.0, 0.98),
            ncols=min(len(handles), columns),
            fontsize="small",
            frameon=False,
            handlelength=2.4,
            columnspacing=1.2,
        )


def letter(panels: Sequence[Axes]) -> None:
    """Put (a), (b), … before the notes of panels."""
    for name, axes in zip(string.ascii_lowercase, panels, strict=False):
        note = axes.get_title(loc="left")
        axes.set_title(f"({name}) {note}".rstrip(), loc="left", fontsize="small")


def shade(axes: Axes, start: float, end: float, label: str = "") -> None:
    """Shade the averaged cycles, from ``start`` to ``end`` on the x axis."""
    axes.axvspan(start, end, color=_AVERAGED, zorder=0, label=label or None)


def branch_style(branch: int, size: float = 4.5) -> dict[str, Any]:
    """Return marker, colour and label of the gaits that gain ``branch`` grooves per cycle."""
    kind = (branch - 1) % len(CYCLE)
    return {
        "marker": MARKERS[kind],
        "color": CYCLE[kind],
        "markersize": size,
        "linestyle": "none",
        "label": f"{branch} groove{'s' if branch > 1 else ''} per cycle",
    }
