# SPDX-License-Identifier: Apache-2.0
"""Figure of the predicted and measured speeds of robust and nominal gaits."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from worm_model.analysis.plot_style import BLUE, VERMILION, finish, new_figure, save_figure
from worm_optimizer.operation.spread import Spread
from worm_optimizer.report.agreement import COMPARED, title_of

_WIDTH = 0.3  # half the length of the line of a prediction


def draw_spread(path: Path, spreads: Sequence[Spread]) -> None:
    """Write the figure: a dot for each repeat, a line for the prediction."""
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
            f"{title_of(row.name).replace(', ', chr(10))}\n{row.kept} of {row.repeats} kept"
            for row in spreads
        ],
    )
    axes.set_ylim(bottom=0.0)
    finish(axes, "speed (mm/s)", "line: promised with its margin; dot: one run")
    save_figure(figure, path)
