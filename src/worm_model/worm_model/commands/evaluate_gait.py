# SPDX-License-Identifier: Apache-2.0
"""Command line: speed, power and cost of transport of a gait, or of a table of gaits."""

from __future__ import annotations

import argparse
from dataclasses import asdict, replace
from typing import TYPE_CHECKING, Any

from worm_model.commands.command_line import (
    InputError,
    Parser,
    ProgressLine,
    executable,
    new_file,
    print_result,
)
from worm_model.gait import FORWARD, Gait, Profile, gait_of
from worm_model.loads import under
from worm_model.parameters import Parameters, load_parameters
from worm_model.text_table import labelled
from worm_msgs.conditions import LEVEL, Conditions, conditions_of
from worm_msgs.gait import MAX_STROKE

if TYPE_CHECKING:
    from worm_model.simulation.simulator import GaitResult

# The simulator is imported where it is used, because --help does not need it and its compiler starts slowly.

_NEARBY = (
    1e-9  # m; difference in stroke beyond the accuracy of a robot, and within that of the simulator
)
_VISIBLE = (
    1e-3  # relative difference of power, or difference of grooves per cycle, that the text shows
)


def decided_by_rounding(result: GaitResult, parameters: Parameters) -> list[str]:
    """Return the ranges of the grooves and of the power, as texts, if they differ visibly at strokes `_NEARBY`.

    They do for a gait on an edge, and for a robot whose motion exceeds double precision.
    """
    from worm_model.simulation.simulator import evaluate_gait

    stroke = result.gait.stroke
    nearby = max(stroke - _NEARBY, 0.0), min(stroke + _NEARBY, MAX_STROKE)
    gaits = (replace(result.gait, stroke=changed) for changed in nearby)
    results = [result, *(evaluate_gait(gait, parameters) for gait in gaits)]
    grooves, powers = sorted(r.grooves_per_cycle for r in results), sorted(r.power for r in results)
    texts = []
    if grooves[-1] - grooves[0] > _VISIBLE:
        texts.append(f"{grooves[0]:.3f} to {grooves[-1]:.3f} grooves per cycle")
    if powers[-1] > (1.0 + _VISIBLE) * powers[0]:
        texts.append(f"{powers[0]:.4f} to {powers[-1]:.4f} W")
    return texts


def gait_json(result: GaitResult, conditions: Conditions) -> dict[str, Any]:
    """Return the results of a gait under conditions, for the machine-readable output."""
    return {
        **asdict(result.gait),
        "conditions": asdict(conditions),
        "speed": result.speed,
        "power": result.power,
        "cost_of_transport": result.cost_of_transport,
        "grooves_per_cycle": result.grooves_per_cycle,
        "groove_phase": result.groove_phase,
        "switches": result.switches,
    }


def _waveform(gait: Gait) -> str:
    """Return the differences from the paper's waveform as text; empty for the paper's waveform."""
    text = ""
    if gait.pretension:
        text += f", pretension {gait.pretension * 1e3:.2f} mm"
    if gait.contraction_share != 0.5:
        text += f", contraction share {gait.contraction_share:.3f}"
    if gait.profile is Profile.TRAPEZOID:
        text += f", trapezoid with a ramp share of {gait.ramp_share:.3f}"
    return text


def describe(result: GaitResult, parameters: Parameters, cycles: int = 5) -> str:
    """Return the results of a gait that was run for a number of cycles, as text.

    The text states the groove phase, because the speed is valid only at this phase.
    """
    gait = result.gait
    way = "forward" if gait.direction == FORWARD else "reverse"
    load = (
        f"{parameters.rear_load:.3f} N on the rear and {parameters.front_load:.3f} N on the front module, "
        "positive towards -x"
    )
    return labelled(
        {
            "gait": f"{gait.stroke * 1e3:.2f} mm at {gait.frequency:.4f} Hz, {way}, "
            f"margin {gait.margin * 1e3:.2f} mm{_waveform(gait)}",
            **({"load": load} if parameters.rear_load or parameters.front_load else {}),
            "speed": f"{result.speed * 1e3:.4f} mm/s at a groove phase of {result.groove_phase * 1e3:+.2f} mm",
            "power": f"{result.power:.4f} W",
            "cost of transport": f"{result.cost_of_transport:.2f}",
            "grooves per cycle": f"{result.grooves_per_cycle:.3f} "
            f"({result.switches} switches of an anchor in {cycles} cycles)",
        }
    )


def _parser() -> Parser:
    parser = Parser(
        prog="evaluate_gait",
        description="Print speed, power and cost of transport of a gait: five cycles from the start, the "
        "last three averaged.",
    )
    parser.add_gait()
    parser.add_conditions()
    parser.add_argument("--gaits", metavar="IN.csv", help="evaluate a table of gaits instead")
    parser.add_argument("--output", metavar="OUT.csv", help="file for the results of the table")
    parser.add_json()
    parser.add_parameters()
    return parser


def _evaluate_table(options: argparse.Namespace, parameters: Parameters) -> None:
    if options.output is None:
        raise InputError("--gaits requires --output, the file for the results")
    import numpy as np

    from worm_model.simulation.gait_table import evaluate_table, read_gaits, write_table

    if conditions_of(options) != LEVEL:
        raise InputError(
            "conditions apply to one gait; in a table, use the columns rear_load and front_load, N"
        )
    output = new_file(options.output)
    overrides, table = evaluate_table(read_gaits(options.gaits), parameters, ProgressLine("gaits"))
    write_table(output, table, overrides, parameters)
    count = int(table.speed.size)
    failed = [int(row) + 2 for row in np.flatnonzero(np.isnan(table.speed))]
    text = f"{count} gaits written to {output}"
    if failed:
        lines = ", ".join(map(str, failed[:10])) + (", ..." if len(failed) > 10 else "")
        text += (
            f"; {len(failed)} of them have no results (nan), lines {lines}: the fins do not hold the load at rest, "
            "or the simulation needs too many steps, probably because a fin switches without end"
        )
    print_result(options, {"output": str(output), "gaits": count, "without_figures": failed}, text)


def _evaluate(options: argparse.Namespace) -> None:
    parameters = load_parameters(options.parameters)
    if options.gaits is not None:
        _evaluate_table(options, parameters)
        return
    if options.output is not None:
        raise InputError(
            "--output has no effect without --gaits; the results of one gait are printed"
        )
    if options.stroke is None or options.frequency is None:
        raise InputError("give --stroke and --frequency, or --gaits IN.csv --output OUT.csv")
    gait = gait_of(options)
    conditions = conditions_of(options)
    parameters = under(conditions, parameters)
    from worm_model.simulation.simulator import evaluate_gait

    result = evaluate_gait(gait, parameters)
    ranges, text = decided_by_rounding(result, parameters), describe(result, parameters)
    if ranges:
        text += f"\nrounding decides: strokes that differ by {1e9 * _NEARBY:g} nm give {' and '.join(ranges)}"
    print_result(options, {**gait_json(result, conditions), "decided_by_rounding": ranges}, text)


main = executable(_parser, _evaluate)
