# SPDX-License-Identifier: Apache-2.0
"""Command line: effect of adjusting the initial length."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

import numpy as np

from worm_model.commands.command_line import (
    InputError,
    Parser,
    ProgressLine,
    executable,
    figure_file,
    print_result,
)
from worm_model.gait import STROKE_RANGE
from worm_model.loads import under
from worm_model.parameters import load_parameters
from worm_model.text_table import text_table
from worm_msgs.conditions import conditions_of
from worm_msgs.gait import SHAPE, Gait

if TYPE_CHECKING:
    from worm_model.analysis.groove_phases import PhaseMap


def _parser() -> Parser:
    parser = Parser(
        prog="phase_map",
        description="Compute grooves per cycle over stroke and groove phase, and the margin's cliff over the phase. "
        "They show the effect of adjusting the initial length.",
    )
    parser.add_number("--frequency", "HZ", "frequency in Hz", 0.15)
    parser.add_number("--lowest", "M", "smallest stroke in m", STROKE_RANGE[0])
    parser.add_number("--highest", "M", "largest stroke in m", STROKE_RANGE[1])
    parser.add_gait(SHAPE)
    parser.add_argument(
        "--points", type=int, default=161, metavar="N", help="points per axis (default 161)"
    )
    parser.add_conditions()
    parser.add_figure()
    parser.add_json()
    parser.add_parameters()
    return parser


def describe(content: PhaseMap) -> str:
    """Return a summary of the map as text."""
    lines = [
        f"groove phase now {content.phase_now * 1e3:+.2f} mm: cliff of the margin at "
        f"{content.cliff_now * 1e3:.2f} mm (closed form)",
    ]
    rows = [
        (
            "phase (mm)",
            "cliff (mm)",
            f"least stroke (mm) for 1, 2, … grooves at {content.frequency:g} Hz",
        )
    ]
    for row in range(0, content.phase.size, max(1, content.phase.size // 16)):
        least = []
        for n in range(1, int(content.grooves.max()) + 1):
            reached = content.stroke[content.grooves[row] >= n]
            least.append(f"{reached[0] * 1e3:.1f}" if reached.size else "none")
        rows.append(
            (
                f"{content.phase[row] * 1e3:.2f}",
                f"{content.cliff[row] * 1e3:.2f}",
                ", ".join(least),
            )
        )
    return "\n".join([*lines, text_table(rows)])


def _map(options: argparse.Namespace) -> None:
    from worm_model.analysis.groove_phases import (  # here: Numba and Matplotlib load slowly
        compute_phase_map,
        phase_map_figure,
    )
    from worm_model.analysis.plot_style import save_figure

    if not 2 <= options.points <= 2000:
        raise InputError("--points: give between 2 and 2000 points per axis")
    if not 0.0 < options.lowest < options.highest:
        raise InputError("--lowest must be above 0 and below --highest, both in metres")
    shape = {name: getattr(options, name) for name in SHAPE}
    gait = Gait(options.highest, options.frequency, **shape)
    parameters = under(conditions_of(options), load_parameters(options.parameters))
    figure = figure_file(options)
    pitch = parameters.pitch
    # The phases cover (−d/2, d/2]. −d/2 is omitted, because it is equivalent to d/2.
    phase = np.linspace(-0.5 * pitch, 0.5 * pitch, options.points + 1)[1:]
    stroke = np.linspace(options.lowest, options.highest, options.points)
    content = compute_phase_map(parameters, gait, stroke, phase, ProgressLine("phase map"))
    if figure is not None:
        save_figure(phase_map_figure(content), figure)
    result = {
        "frequency": content.frequency,
        "stroke": content.stroke,
        "groove_phases": content.phase,
        "grooves_per_cycle": content.grooves,
        "closed_form_cliff_margin": content.cliff,
        "groove_phase": content.phase_now,
    }
    print_result(options, result, describe(content))


main = executable(_parser, _map)
