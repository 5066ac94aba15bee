# SPDX-License-Identifier: Apache-2.0
"""Command line: grooves per cycle over stroke and groove phase, and the margin's cliff over the phase.

It shows what trimming L0 would buy: turning a screw by millimetres moves the groove phase, and with it
the strokes that gain a further groove and the margin that can be had.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from worm_model.commands.command_line import (
    InputError,
    Parser,
    Progress,
    add_parameters,
    new_file,
    number,
    print_json,
    run_command,
)
from worm_model.parameters import Parameters, load_parameters
from worm_model.simulation.batch import evaluate_gaits
from worm_model.simulation.closed_form import cliff_margin, front_groove, groove_phase

Array = NDArray[np.float64]


@dataclass(frozen=True)
class PhaseMap:
    """``grooves`` (m, n) per cycle over ``phase`` (m,) and ``stroke`` (n,) in m, at one frequency in Hz.

    ``cliff`` (m,) is the closed-form cliff of the margin in m; ``phase_now`` the groove phase of the
    parameters themselves.
    """

    frequency: float
    stroke: Array
    phase: Array
    grooves: Array
    cliff: Array
    phase_now: float
    cliff_now: float


def compute_phase_map(
    parameters: Parameters,
    frequency: float,
    stroke: Array,
    phase: Array,
    progress: Progress | None = None,
) -> PhaseMap:
    """Simulates every stroke (n,) in m at every groove phase (m,) in m, φ set by L0 alone."""
    groove = front_groove(parameters)
    lengths = groove * parameters.pitch + phase
    table = evaluate_gaits(
        stroke[np.newaxis, :],
        frequency,
        parameters=parameters,
        overrides={"initial_length": lengths[:, np.newaxis]},
        progress=progress,
    )
    cliff = [cliff_margin(parameters.replace(initial_length=length)) for length in lengths]
    return PhaseMap(
        frequency,
        stroke,
        phase,
        np.round(table.grooves_per_cycle),
        np.array(cliff),
        groove_phase(parameters),
        cliff_margin(parameters),
    )


def draw_phase_map(content: PhaseMap, path: Path) -> None:
    """Draws the map beside the cliff and writes the figure, its format by the name's ending."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt
    from matplotlib.colors import BoundaryNorm

    figure, (left, right) = plt.subplots(
        1, 2, figsize=(10.5, 4.5), sharey=True, width_ratios=(3, 2), layout="constrained"
    )
    most = int(max(content.grooves.max(), 1))
    levels = np.arange(-0.5, most + 1.5)
    image = left.pcolormesh(
        content.stroke * 1e3,
        content.phase * 1e3,
        content.grooves,
        cmap=plt.get_cmap("cividis", most + 1),
        norm=BoundaryNorm(levels, most + 1),
        shading="nearest",
        rasterized=True,
    )
    figure.colorbar(image, ax=left, ticks=np.arange(most + 1), label="grooves per cycle", pad=0.02)
    left.set(
        xlabel="stroke S (mm)",
        ylabel="groove phase φ (mm)",
        title=f"Grooves per cycle at {content.frequency:g} Hz",
    )
    right.plot(content.cliff * 1e3, content.phase * 1e3, color="#0072B2")
    right.axvline(0.0, color="0.7", linewidth=0.8)
    right.plot(content.cliff_now * 1e3, content.phase_now * 1e3, "o", color="#D55E00")
    right.set(xlabel="cliff of the margin δ_m* (mm), closed form", title="Margin to be had")
    for axes in (left, right):
        axes.axhline(content.phase_now * 1e3, color="#D55E00", linestyle="--", linewidth=1.2)
    right.margins(x=0.08)
    right.annotate(
        f"now: φ = {content.phase_now * 1e3:.2f} mm,\nδ_m* = {content.cliff_now * 1e3:.2f} mm",
        (content.cliff_now * 1e3, content.phase_now * 1e3),
        textcoords="offset points",
        xytext=(-8, 8),
        ha="right",
        color="#A03C00",
    )
    figure.savefig(path, dpi=150)
    plt.close(figure)


def _parser() -> Parser:
    parser = Parser(
        prog="phase_map",
        description="Grooves per cycle over stroke and groove phase, and the margin's cliff over "
        "the phase: what trimming the initial length would buy.",
    )
    parser.add_argument("--frequency", type=number, default=0.15, metavar="HZ", help="default 0.15")
    parser.add_argument("--lowest", type=number, default=0.01, metavar="M", help="least stroke, m")
    parser.add_argument(
        "--highest", type=number, default=0.09, metavar="M", help="largest stroke, m"
    )
    parser.add_argument(
        "--points", type=int, default=161, metavar="N", help="per axis (default 161)"
    )
    parser.add_argument("--figure", metavar="FILE", help="write a figure (.png, .pdf or .svg)")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    add_parameters(parser)
    return parser


def describe(content: PhaseMap) -> str:
    """What the map says, for people."""
    lines = [
        f"groove phase now {content.phase_now * 1e3:+.2f} mm: cliff of the margin at "
        f"{content.cliff_now * 1e3:.2f} mm (closed form)",
        f"{'phase (mm)':>10}  {'cliff (mm)':>10}  least stroke (mm) for 1, 2, … grooves "
        f"at {content.frequency:g} Hz",
    ]
    for row in range(0, content.phase.size, max(1, content.phase.size // 16)):
        least = []
        for n in range(1, int(content.grooves.max()) + 1):
            reached = content.stroke[content.grooves[row] >= n]
            least.append(f"{reached[0] * 1e3:.1f}" if reached.size else "none")
        lines.append(
            f"{content.phase[row] * 1e3:10.2f}  {content.cliff[row] * 1e3:10.2f}  {', '.join(least)}"
        )
    return "\n".join(lines)


def _map(options: argparse.Namespace) -> None:
    if not 2 <= options.points <= 2000:
        raise InputError("--points: give between 2 and 2000 points per axis")
    if not 0.0 < options.lowest < options.highest:
        raise InputError("--lowest must be above 0 and below --highest, both in metres")
    parameters = load_parameters(options.parameters)
    figure = new_file(options.figure) if options.figure else None
    pitch = parameters.pitch
    # (−d/2, d/2]: the lower end is the upper end of the next groove
    phase = np.linspace(-0.5 * pitch, 0.5 * pitch, options.points + 1)[1:]
    stroke = np.linspace(options.lowest, options.highest, options.points)
    content = compute_phase_map(parameters, options.frequency, stroke, phase, Progress("phase map"))
    if figure is not None:
        draw_phase_map(content, figure)
    if options.json:
        print_json(
            {
                "frequency": content.frequency,
                "stroke": content.stroke,
                "groove_phases": content.phase,
                "grooves_per_cycle": content.grooves,
                "closed_form_cliff_margin": content.cliff,
                "groove_phase": content.phase_now,
            }
        )
    else:
        sys.stdout.write(describe(content) + "\n")


def main() -> int:
    """Entry point of the executable phase_map."""
    return run_command(_parser(), _map)
