# SPDX-License-Identifier: Apache-2.0
"""Command line: the price of robustness and its cliff."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from worm_model.commands.command_line import (
    Parser,
    elapsed,
    executable,
    figure_file,
    print_result,
)
from worm_model.parameters import load_parameter_file
from worm_model.text_table import labelled, text_table
from worm_optimizer.commands.search_options import add_scan_options, chosen_settings

if TYPE_CHECKING:  # Numba loads slowly
    from worm_optimizer.search.price_of_robustness import PriceOfRobustness


def _parser() -> Parser:
    parser = Parser(
        prog="scan_margin",
        description="Compute the lowest cost of transport over the robustness margin, minimised over the gaits of the "
        "box, and its cliff. The result states the rule that defines a cliff.",
    )
    add_scan_options(parser)
    return parser


def price_json(price: PriceOfRobustness) -> dict[str, Any]:
    """Return a scan for the machine-readable output."""
    from worm_optimizer.search.front import price_warning
    from worm_optimizer.search.price_of_robustness import CLIFF_RULE

    cliff = price.cliff
    return {
        "margins": [point.margin for point in price.points],
        "cost_of_transport": [point.cost_of_transport for point in price.points],
        "optimal_branch": [point.branch for point in price.points],
        "branches": [list(point.branches) for point in price.points],
        "cliff_margin": cliff.margin if cliff else None,
        "chosen_margin": price.margin if price.moves else None,
        "cliff_rise": cliff.rise if cliff else None,
        "lost_branch": cliff.lost_branch if cliff else None,
        "closed_form_cliff_margin": price.closed_form_cliff_margin,
        "groove_phase": price.groove_phase,
        "rule": CLIFF_RULE,
        "warning": price_warning(price),
    }


def describe(price: PriceOfRobustness) -> str:
    """Return a scan as text."""
    from worm_optimizer.search.front import price_warning
    from worm_optimizer.search.price_of_robustness import CLIFF_RULE

    rows = [("margin (mm)", "lowest COT", "at S (mm)", "f (Hz)", "branches")]
    for point in price.points[:: max(1, len(price.points) // 16)]:
        branches = ", ".join(f"{branch:g}" for branch in point.branches) or "none moves"
        gait = (f"{1e3 * point.stroke:.2f}", f"{point.frequency:.4f}")
        cost = f"{point.cost_of_transport:.2f}"
        rows.append((f"{1e3 * point.margin:.2f}", cost, *gait, branches))
    found = {
        "groove phase": f"{1e3 * price.groove_phase:+.2f} mm",
        "cliff": f"{1e3 * price.cliff.margin:.3f} mm: beyond this margin, {price.cliff.consequence}"
        if price.cliff
        else "none among these margins",
        "closed form": f"{1e3 * price.closed_form_cliff_margin:.3f} mm, in the slow limit",
        "rule": CLIFF_RULE,
        **({"warning": warning} if (warning := price_warning(price)) else {}),
    }
    return f"{text_table(rows)}\n{labelled(found)}"


def _scan(options: argparse.Namespace) -> None:
    from worm_optimizer.search.front import scanned_price

    content = load_parameter_file(options.parameters)
    settings, figure = chosen_settings(options), figure_file(options)
    with elapsed("margins"):
        price = scanned_price(content, settings, options.direction)
    if figure is not None:
        from worm_model.analysis.plot_style import save_figure  # here: matplotlib loads slowly
        from worm_optimizer.report.front_plots import price_figure

        save_figure(price_figure(price), figure)
    print_result(options, price_json(price), describe(price))


main = executable(_parser, _scan)
