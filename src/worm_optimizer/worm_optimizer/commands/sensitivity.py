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
from worm_optimizer.robustness.sobol import (
    INDEX_HEADS,
    NO_INDICES,
    index_cells,
    index_json,
    warnings_of,
)

if TYPE_CHECKING:  # SciPy and Numba load slowly
    from worm_optimizer.robustness.sensitivity import Sensitivity

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
    from worm_optimizer.robustness.sensitivity import SYMBOLS, UNITS

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
