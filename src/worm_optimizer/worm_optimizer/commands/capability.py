# SPDX-License-Identifier: Apache-2.0
"""Command line: largest loads and slopes of a robot's gaits, and lowest cost of transport and highest speed by load."""

from __future__ import annotations

import argparse
from dataclasses import asdict, replace
from typing import TYPE_CHECKING, Any

from worm_model.commands.command_line import (
    InputError,
    Parser,
    elapsed,
    executable,
    figure_file,
    print_result,
)
from worm_model.gait import Gait
from worm_model.loads import content_under
from worm_model.parameters import load_parameter_file
from worm_model.text_table import text_table
from worm_optimizer.commands.search_options import add_front_options, chosen_settings

if TYPE_CHECKING:  # Numba loads slowly
    from worm_optimizer.search.capability import Capability, LoadPoint


def _parser() -> Parser:
    parser = Parser(
        prog="capability",
        description="Compute the largest load on the rear module and the largest slope for a given gait, the three "
        "gaits of the front (min_power, cruise, max_speed) and the strongest gait (best), which moves with the largest "
        "load. Also compute the lowest cost of transport and the highest speed as functions of the load. With "
        "--tether-per-metre and without --tether-length, also compute how many metres of tether each gait can drag.",
    )
    parser.add_number("--stroke", "M", "stroke of the given gait in m")
    parser.add_number("--frequency", "HZ", "frequency of the given gait in Hz")
    add_front_options(parser)
    return parser


def capability_json(
    found: dict[str, Capability], points: tuple[LoadPoint, ...], per_metre: float
) -> dict[str, Any]:
    """Return the capabilities for the machine-readable output.

    ``found`` contains the capability of each gait by name; its last element is the strongest gait.
    ``per_metre`` is the force of the tether in N/m; 0 without a tether.
    """
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
    heads = ["gait", "S (mm)", "f (Hz)", "largest load (N)", "all grooves (N)"]
    heads += ["closed form (N)", "slope (°)"] + ["tether (m)"] * bool(per_metre)
    rows = [heads]
    for name, each in found.items():
        gait = each.gait
        loads = (each.largest_load, each.full_load, each.closed_form_largest_load)
        row = [name.replace("_", " "), f"{1e3 * gait.stroke:.2f}", f"{gait.frequency:.4f}"]
        row += [f"{load:.2f}" for load in loads] + [f"{each.largest_slope_deg:.1f}"]
        rows.append([*row, f"{each.largest_load / per_metre:.1f}"] if per_metre else row)
    over_load = [("load (N)", "lowest COT", "highest speed (mm/s)")]
    over_load += [
        (f"{point.load:.2f}", f"{point.cost_of_transport:.2f}", f"{1e3 * point.speed:.3f}")
        for point in points
    ]
    return f"{text_table(rows)}\n\n{text_table(over_load)}"


def _capability(options: argparse.Namespace) -> None:
    from worm_optimizer.search.capability import capabilities, curve, strongest
    from worm_optimizer.search.front import make_front, task_of

    content = load_parameter_file(options.parameters)
    per_metre = 0.0
    if options.tether_length is None and options.tether_per_metre is not None:
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
    with elapsed("front"):
        front = make_front(content, settings, options.direction)
        best = strongest(task)
    gaits |= {name: each.gait for name, each in front.three.items()}
    if best is None:
        raise InputError("no gait of the box moves without a margin: allow longer strokes")
    gaits["best"] = best
    with elapsed("loads"):
        found = dict(zip(gaits, capabilities(task, list(gaits.values())), strict=True))
        points = curve(replace(task, margin=0.0), found["best"].largest_load)
    if figure is not None:
        from worm_model.analysis.plot_style import save_figure  # here: matplotlib loads slowly
        from worm_optimizer.report.front_plots import capability_figure

        save_figure(capability_figure(found, points), figure)
    print_result(
        options, capability_json(found, points, per_metre), describe(found, points, per_metre)
    )


main = executable(_parser, _capability)
