# SPDX-License-Identifier: Apache-2.0
"""Command line: sensitivity of a gait's speed and power, and of the cliff, to the parameters."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from textwrap import indent
from typing import TYPE_CHECKING, Any

import numpy as np

from worm_model.commands.command_line import (
    InputError,
    Parser,
    executable,
    figure_file,
    print_result,
)
from worm_model.loads import content_under
from worm_model.parameters import load_parameter_file
from worm_model.text_table import text_table
from worm_msgs.conditions import conditions_of
from worm_msgs.gait import WAVEFORM, gait_of

if TYPE_CHECKING:  # SciPy and Numba load slowly
    from worm_optimizer.robustness.sensitivity import Indices, Sensitivity

MOST_SAMPLES = 1 << 16  # largest number of base samples


def _parser() -> Parser:
    parser = Parser(
        prog="sensitivity",
        description="Compute Sobol indices of speed, power and the cliff over the uncertainty of the parameters: their "
        "intervals in the parameter file, or default widths for parameters without an interval.",
    )
    parser.add_gait((*WAVEFORM, "direction"), required=True)
    parser.add_argument(
        "--samples",
        type=int,
        default=1024,
        metavar="N",
        help="number of base samples, a power of two (default 1024)",
    )
    parser.add_argument(
        "--seed", type=int, default=0, metavar="N", help="seed of the samples (default 0)"
    )
    parser.add_conditions()
    parser.add_figure()
    parser.add_json()
    parser.add_parameters()
    return parser


#: Heads of the columns that `index_cells` returns.
INDEX_HEADS = ("alone", "95 % bounds", "with others", "95 % bounds")


def index_json(indices: Indices, inputs: Sequence[str]) -> dict[str, Any]:
    """Return the indices of each input with their bounds, for JSON."""
    return {
        key: {
            "first": indices.first[k],
            "first_bounds": indices.first_bounds[:, k],
            "total": indices.total[k],
            "total_bounds": indices.total_bounds[:, k],
        }
        for k, key in enumerate(inputs)
    }


def percent(value: float) -> str:
    """Return a share as a percentage, never as "-0.0 %". Of an impossible share, return the bound that it exceeds."""
    rounded = round(100.0 * value, 1)
    if rounded < 0.0:
        return "< 0 %"
    return "> 100 %" if rounded > 100.0 else f"{rounded + 0.0:.1f} %"


def index_cells(indices: Indices, row: int) -> list[str]:
    """Return the first-order index of an input, its bounds, its total index and the bounds of that as text."""
    first, total = indices.first[row], indices.total[row]
    bounds = indices.first_bounds[:, row], indices.total_bounds[:, row]
    texts = [" to ".join(map(percent, ends)) for ends in bounds]
    return [percent(first), texts[0], percent(total), texts[1]]


def warnings_of(name: str, indices: Indices, inputs: Sequence[str]) -> list[str]:
    """Return the reasons to distrust the indices of a result."""
    if not indices.inconsistent.size:
        return []
    listed = ", ".join(inputs[k] for k in indices.inconsistent)
    return [
        f"{name}: indices of {listed} are below 0 %, above 100 % or in the wrong order: use more samples"
    ]


def sensitivity_json(content: Sensitivity) -> dict[str, Any]:
    """Return the indices by quantity and parameter, with 95 % bounds."""
    result: dict[str, Any] = {"parameters": list(content.parameters)}
    for name, indices in content.indices.items():
        result[name] = {
            "mean": indices.mean,
            "deviation": indices.deviation,
            "indices": index_json(indices, content.parameters),
        }
    return {**result, "evaluations": content.evaluations, "warnings": _warnings(content)}


def _warnings(content: Sensitivity) -> list[str]:
    return [
        text
        for name, indices in content.indices.items()
        for text in warnings_of(name, indices, content.parameters)
    ]


def describe(content: Sensitivity) -> str:
    """Return the most important parameters of each quantity as text."""
    from worm_optimizer.robustness.sensitivity import NO_INDICES, SYMBOLS, UNITS

    shown = {"speed": (1e3, "mm/s"), "power": (1.0, "W"), "cliff_margin": (1e3, "mm")}
    heads = ("parameter", "symbol", *INDEX_HEADS, "range of the parameter")
    lines = []
    for name, indices in content.indices.items():
        scale, unit = shown[name]
        lines.append(
            f"{name}: {scale * indices.mean:.3f} ± {scale * indices.deviation:.3f} {unit} (standard deviation)"
        )
        if np.all(np.isnan(indices.total)):
            lines.append(f"  {NO_INDICES}")
            continue
        rows: list[Sequence[str]] = [heads]
        for k in np.argsort(-indices.total)[:6]:
            key = content.parameters[k]
            below, above = content.reach[key]
            reach = f"-{below:.3g}, +{above:.3g} {UNITS[key]}"
            rows.append((key, SYMBOLS[key], *index_cells(indices, k), reach))
        lines.append(indent(text_table(rows), "  "))
    return "\n".join([*lines, *(f"warning: {text}" for text in _warnings(content))])


def _run(options: argparse.Namespace) -> None:
    if not 2 <= options.samples <= MOST_SAMPLES or options.samples & (options.samples - 1):
        raise InputError(f"--samples {options.samples}: give a power of two, 2 to {MOST_SAMPLES}")
    if not 0 <= options.seed < 2**32:
        raise InputError(f"--seed {options.seed}: give a number from 0 to 4294967295")
    gait = gait_of(options)
    content = content_under(conditions_of(options), load_parameter_file(options.parameters))
    figure = figure_file(options)
    from worm_optimizer.robustness.sensitivity import sensitivity

    result = sensitivity(gait, content, options.samples, options.seed)
    if figure is not None:
        from worm_model.analysis.plot_style import save_figure  # here: matplotlib loads slowly
        from worm_optimizer.report.front_plots import sensitivity_figure

        save_figure(sensitivity_figure(result), figure)
    print_result(options, sensitivity_json(result), describe(result))


main = executable(_parser, _run)
