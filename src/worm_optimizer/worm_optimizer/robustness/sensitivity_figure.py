# SPDX-License-Identifier: Apache-2.0
"""Figure of a sensitivity analysis."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from worm_model.analysis.plot_style import BLUE, LIGHT_GREY, letter, new_figure
from worm_optimizer.robustness.sensitivity import SYMBOLS, Sensitivity
from worm_optimizer.robustness.sobol import NO_INDICES

SHOWN = 10  # number of parameters in the figure; it shows those with the largest total indices
TITLES = {"speed": "speed", "power": "power", "cliff_margin": "cliff of the margin"}


def sensitivity_figure(content: Sensitivity) -> Figure:
    """Draw first-order and total indices of each quantity, with the largest total index on top."""
    figure = new_figure(11.0, 4.5)
    panels = figure.subplots(1, len(content.indices))
    for axes, (name, indices) in zip(panels, content.indices.items(), strict=True):
        if np.all(np.isnan(indices.total)):
            axes.text(0.5, 0.5, NO_INDICES, ha="center", transform=axes.transAxes)
            axes.set(yticks=[])
        else:
            order = np.argsort(-indices.total)[:SHOWN][::-1]
            place = np.arange(order.size)
            for values, bounds, color, height, label in (
                (indices.total, indices.total_bounds, LIGHT_GREY, 0.8, "total"),
                (indices.first, indices.first_bounds, BLUE, 0.4, "alone"),
            ):
                low, high = bounds
                reach = np.maximum([values - low, high - values], 0.0)[:, order]
                axes.barh(place, values[order], height, color=color, label=label, xerr=reach)
            names = [SYMBOLS[content.parameters[k]] for k in order]
            axes.set_yticks(place, names)
            axes.legend(loc="lower right", fontsize="small", frameon=False)
        axes.set_xlabel("share of the variance")
        axes.set_title(TITLES[name], loc="left", fontsize="small")
    letter(panels)
    return figure
