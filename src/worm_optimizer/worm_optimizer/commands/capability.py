# SPDX-License-Identifier: Apache-2.0
"""Command line: the largest loads and slopes of a robot's gaits, and the price of a load."""

from __future__ import annotations

import argparse
from dataclasses import asdict, replace
from typing import Any

from worm_model.analysis.plot_style import save_figure
from worm_model.commands.command_line import (
    InputError,
    Parser,
    figure_file,
    print_result,
    run_command,
)
from worm_model.conditions import content_under
from worm_model.gait import Gait
from worm_model.parameters import load_parameter_file
from worm_optimizer.commands.search_options import add_front_options, chosen_settings
from worm_optimizer.report.capability_figure import capability_figure
from worm_optimizer.search.capability import (
    Capability,
    LoadPoint,
    capabilities,
    curve,
    strongest,
)
from worm_optimizer.search.front import make_front, task_of


def _parser() -> Parser:
    parser = Parser(
        prog="capability",
        description="The largest load on the rear module and the largest slope up to which gaits still move: of your "
        "own gait, of the three gaits of the front, and of the strongest gait; cost of transport "
        "and speed over the load; with --tether-per-metre and without --distance, how far a tether is dragged.",
    )
    parser.add_number("--stroke", "M", "stroke of a gait of your own in m")
    parser.add_number("--frequency", "HZ", "its frequency in Hz")
    add_front_options(parser)
    return parser


def capability_json(
    found: dict[str, Capability], points: tuple[LoadPoint, ...], per_metre: float
) -> dict[str, Any]:
    """Return capabilities as the machine-readable output has them."""
    gaits = [{"name": name, **_row(each, per_metre)} for name, each in found.items()]
    best = gaits.pop()
    return {
        "gaits": gaits,
        "best": best,
        "closed_form_largest_load": best["closed_form_largest_load"],
        "loads": [asdict(point) for point in points],
    }


def _row(each: Capability, per_metre: float) -> dict[str, Any]:
    reach = {"tether_m": each.largest_load / per_metre} if per_metre else {}
    return {**asdict(each), **reach}


def describe(found: dict[str, Capability], points: tuple[LoadPoint, ...], per_metre: float) -> str:
    """Return capabilities as text."""
    lines = [
        f"{'gait':<12} {'S':>6} {'f':>7} {'largest load':>13} {'all grooves':>12} {'closed form':>12} {'slope':>6}"
        + ("  tether" if per_metre else ""),
        f"{'':<12} {'mm':>6} {'Hz':>7} {'N':>13} {'N':>12} {'N':>12} {'°':>6}"
        + (f"  {'m':>6}" if per_metre else ""),
    ]
    for name, each in found.items():
        gait = each.gait
        reach = f"  {each.largest_load / per_metre:6.1f}" if per_metre else ""
        lines.append(
            f"{name.replace('_', ' '):<12} {1e3 * gait.stroke:6.2f} {gait.frequency:7.4f} {each.largest_load:13.2f}"
            f" {each.full_load:12.2f} {each.closed_form_largest_load:12.2f} {each.largest_slope_deg:6.1f}{reach}"
        )
    lines += ["", f"{'load (N)':>8}  {'lowest COT':>10}  {'highest speed (mm/s)':>20}"]
    lines += [
        f"{point.load:8.2f}  {point.cost_of_transport:10.2f}  {1e3 * point.speed:20.3f}"
        for point in points
    ]
    return "\n".join(lines)


def _capability(options: argparse.Namespace) -> None:
    content = load_parameter_file(options.parameters)
    per_metre = 0.0
    if options.distance is None and options.tether_per_metre is not None:
        per_metre, options.tether_per_metre = options.tether_per_metre, None
        if not per_metre > 0.0:
            raise InputError(f"--tether-per-metre {per_metre:g}: give a positive force in N/m")
    if (options.stroke is None) != (options.frequency is None):
        raise InputError("--stroke and --frequency belong together. Give both")
    settings, figure = chosen_settings(options), figure_file(options)
    task = task_of(content_under(settings.conditions, content), settings, options.direction)
    gaits: dict[str, Gait] = {}
    if options.stroke is not None:
        gaits["given"] = Gait(options.stroke, options.frequency, options.direction)
    front = make_front(content, settings, options.direction)
    gaits |= {name: each.gait for name, each in front.three.items()}
    best = strongest(task)
    if best is None:
        raise InputError("no gait of the box moves without a margin: allow longer strokes")
    gaits["best"] = best
    found = dict(zip(gaits, capabilities(task, list(gaits.values())), strict=True))
    points = curve(replace(task, margin=0.0), found["best"].largest_load)
    if figure is not None:
        save_figure(capability_figure(found, points), figure)
    print_result(
        options, capability_json(found, points, per_metre), describe(found, points, per_metre)
    )


def main() -> int:
    """Entry point of the executable capability."""
    return run_command(_parser(), _capability)
