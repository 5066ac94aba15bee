# SPDX-License-Identifier: Apache-2.0
"""Command line: drift of parameters from bag to bag, with control limits."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from worm_model.commands.command_line import (
    InputError,
    Parser,
    ProgressLine,
    executable,
    print_result,
)
from worm_model.identification.drift import ADVICE, FEWEST_BAGS, MARGIN, Chart, State, chart_of
from worm_model.parameters import UNITS, load_parameter_file

if TYPE_CHECKING:
    from worm_model.identification.drift_estimates import BagEstimates


def _parser() -> Parser:
    parser = Parser(
        prog="health",
        description="Estimate friction, switching threshold, gain, slack, idle power and measured margin from each "
        "bag alone, and report which of them drift over the bags, since when, and what to check.",
    )
    parser.add_argument("bags", nargs="+", type=Path, metavar="BAG", help="one run each, any order")
    parser.add_json()
    parser.add_parameters()
    return parser


def _health(options: argparse.Namespace) -> None:
    from worm_model.identification.drift_estimates import estimate_bags  # here: Numba loads slowly

    for path in options.bags:
        if not path.exists():
            raise InputError(f"{path}: does not exist")
    known = load_parameter_file(options.parameters)
    bags, left_out = estimate_bags(options.bags, known.parameters, ProgressLine("health"))
    if not bags:
        more = f" (and {len(left_out) - 1} more)" if len(left_out) > 1 else ""
        raise InputError(
            f"no bag can be used: {left_out[0]}{more}; give bags with one gait each that begins at rest"
        )
    charts = [chart_of(key, [bag.estimates[key] for bag in bags], known) for key in ADVICE]
    remarks = _remarks(bags, charts)
    content = {
        "healthy": all(chart.state is State.WITHIN for chart in charts),
        "parameters": {chart.key: _chart_json(chart, bags) for chart in charts},
        "bags": [_bag_json(bag) for bag in bags],
        "left_out": [{"bag": bag.name, "reason": bag.reason} for bag in left_out],
        "remarks": remarks,
    }
    first, last = bags[0], bags[-1]
    lines = [
        f"{'1 bag' if len(bags) == 1 else f'{len(bags)} bags'}, {first.name} ({first.recording.date}) to "
        f"{last.name} ({last.recording.date})",
        *(line for chart in charts for line in _lines(chart, bags)),
        *(remark for bag in bags for remark in bag.remarks),
        *remarks,
        *(f"left out: {bag}" for bag in left_out),
    ]
    print_result(options, content, "\n".join(lines))


def _bag_json(bag: BagEstimates) -> dict[str, Any]:
    gait = {name: value for name, value in asdict(bag.recording.gait).items() if name != "margin"}
    return {
        "bag": bag.name,
        "start": bag.recording.date,
        **gait,
        "estimates": {key: estimate.as_dict() for key, estimate in bag.estimates.items()},
        "remarks": bag.remarks,
    }


def _chart_json(chart: Chart, bags: Sequence[BagEstimates]) -> dict[str, Any]:
    limits = chart.limits
    return {
        "verdict": chart.state.value,
        "began": None if chart.began is None else bags[chart.began].name,
        "direction": chart.direction,
        "lower_limit": limits.low if limits else None,
        "centre": limits.centre if limits else None,
        "upper_limit": limits.high if limits else None,
        "limits_from": limits.source if limits else None,
        "signals": [
            {
                "rule": signal.rule.value,
                "first": bags[signal.first].name,
                "last": bags[signal.last].name,
                "direction": signal.direction,
            }
            for signal in chart.signals
        ],
        "advice": chart.advice or None,
    }


def _lines(chart: Chart, bags: Sequence[BagEstimates]) -> list[str]:
    unit = "m" if chart.key == MARGIN else UNITS[chart.key]
    unit = "" if unit == "1" else f" {unit}"
    head = f"{chart.key}: {chart.state.value}"
    if chart.began is not None:
        head += f" since {bags[chart.began].name}"
    known = chart.value[np.isfinite(chart.value)]
    lines = [
        f"{head}; " + (f"last {known[-1]:.4g}{unit}" if known.size else "no bag determines it")
    ]
    if chart.limits is not None:
        lines.append(
            f"  limits {chart.limits.low:.4g} to {chart.limits.high:.4g}{unit} from {chart.limits.source}"
        )
    for signal in chart.signals:
        where = "up" if signal.direction > 0 else "down"
        first, last = chart.value[signal.first], chart.value[signal.last]
        lines.append(
            f"  {where}, {signal.rule.value}: {bags[signal.first].name} ({first:.4g}{unit}) to "
            f"{bags[signal.last].name} ({last:.4g}{unit})"
        )
    if chart.advice:
        lines.append(f"  {chart.advice}; then identify the robot again")
    return lines


def _remarks(bags: Sequence[BagEstimates], charts: Sequence[Chart]) -> list[str]:
    """Return remarks on limitations that apply to all verdicts."""
    remarks = []
    few = [chart.key for chart in charts if chart.state is State.TOO_FEW]
    if few:
        remarks.append(
            f"too few bags for limits of {', '.join(few)}: give at least {FEWEST_BAGS} bags that determine them, or a "
            "parameter file with their intervals (identify writes one)"
        )
    if len({bag.recording.gait for bag in bags}) > 1:
        remarks.append(
            "the bags contain different gaits: errors of the model differ between gaits, and may look like drift"
        )
    return remarks


main = executable(_parser, _health)
