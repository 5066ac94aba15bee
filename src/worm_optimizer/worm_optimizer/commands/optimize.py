# SPDX-License-Identifier: Apache-2.0
"""Command line: the exact robust front, or that of NSGA-II, with the paper's three gaits with and without a margin."""

from __future__ import annotations

import argparse
import math
from dataclasses import asdict, fields
from typing import TYPE_CHECKING, Any

from worm_model.commands.command_line import (
    Parser,
    ProgressLine,
    elapsed,
    executable,
    figure_file,
    print_result,
)
from worm_model.errors import InputError
from worm_model.parameters import load_parameter_file
from worm_model.text_table import labelled
from worm_optimizer.commands.search_options import (
    add_front_options,
    chosen_settings,
    gait_table,
    shape_lines,
    success_lines,
)
from worm_optimizer.evaluation.task import EDGE_TOLERANCE
from worm_optimizer.gait_prediction import Prediction
from worm_optimizer.search.search_settings import Nsga2Settings, Waveform

if TYPE_CHECKING:
    from worm_optimizer.search.front import RobustFront
    from worm_optimizer.search.nsga2 import Comparison

# Fields of `Prediction` that are computed only for the three gaits. For the other gaits of the front they are NaN.
_FULL = {
    row.name
    for row in fields(Prediction)
    if isinstance(row.default, float) and math.isnan(row.default)
}
EXACT, NSGA2 = "exact", "nsga2"
_SIZES = ("population", "generations")  # settings of NSGA-II that are options


def _parser() -> Parser:
    parser = Parser(
        prog="optimize",
        description="Compute the front of speed and power over stroke and frequency at a robustness margin, from the "
        "lower edges of the branches. Print the minimum-power, cruising and maximum-speed gaits that are best with the "
        "margin, and those that are best without it. With --method nsga2, search the front with the paper's method and "
        "compare it with the exact one.",
    )
    add_front_options(parser)
    parser.add_argument(
        "--method", choices=(EXACT, NSGA2), default=EXACT, help="search method (default exact)"
    )
    for option in _SIZES:
        usual = getattr(Nsga2Settings, option)
        parser.add_argument(
            f"--{option}", type=int, metavar="N", help=f"{option} of nsga2 (default {usual})"
        )
    return parser


def front_json(front: RobustFront, nominal: dict[str, Prediction]) -> dict[str, Any]:
    """Return a front for the machine-readable output. ``nominal`` contains the three gaits without a margin."""
    return {
        "front": [_predicted(gait) for gait in front.gaits],
        "direction": front.direction,
        "margin": front.margin,
        "margin_reason": front.reason,
        **{name: asdict(gait) for name, gait in front.three.items()},
        "nominal": {name: asdict(gait) for name, gait in nominal.items()},
        "verification": {"edge_tolerance": EDGE_TOLERANCE, "power_rises": front.exact.power_rises},
        "warning": front.warning(front.three.values()),
    }


def _predicted(gait: Prediction) -> dict[str, Any]:
    """Return a gait of the front without the fields that only the three gaits have."""
    return {name: value for name, value in asdict(gait).items() if name not in _FULL}


def describe(
    front: RobustFront,
    nominal: dict[str, Prediction],
    uncertainty: str,
    comparison: Comparison | None = None,
) -> str:
    """Return a front, and its comparison with the exact front if it is not exact, as text."""
    rises = "rises" if front.exact.power_rises else "does not rise everywhere"
    summary = {
        **({"NSGA-II": _comparison_text(comparison)} if comparison else {}),
        "margin": f"{1e3 * front.margin:.2f} mm: {front.reason}",
        "groove phase": f"{1e3 * front.three['cruise'].groove_phase:+.2f} mm; all speeds hold for this phase",
        "front": f"{len(front.gaits)} gaits",
        "verified": f"edges located to {1e9 * EDGE_TOLERANCE:g} nm; power {rises} with the stroke within the branches",
        "limits": front.settings.limits.description() or "none",
    }
    return "\n".join(
        [
            labelled(summary),
            "",
            gait_table(front.three, nominal),
            *shape_lines(front.three),
            "",
            success_lines(uncertainty, front.warning(front.three.values())),
        ]
    )


def _comparison_text(comparison: Comparison) -> str:
    missed = ", ".join(f"{branch:g}" for branch in comparison.missed_branches) or "none"
    return (
        f"{100.0 * comparison.hypervolume_share:.2f} % of the exact front's hypervolume; gaits of "
        f"NSGA-II need up to {100.0 * comparison.largest_excess_power:.2f} % more power; missed branches: {missed}"
    )


def _optimize(options: argparse.Namespace) -> None:
    from worm_optimizer.robustness.uncertainty import description  # here: Numba loads slowly
    from worm_optimizer.search.front import make_front, nominal_gaits, replaced

    content = load_parameter_file(options.parameters)
    settings, figure = chosen_settings(options), figure_file(options)
    given = {name: vars(options)[name] for name in _SIZES if vars(options)[name] is not None}
    if options.method == EXACT and given:
        raise InputError("--population and --generations need --method nsga2")
    if options.method == NSGA2 and settings.waveform is Waveform.SHAPED:
        raise InputError(
            "--method nsga2 searches the paper's gaits only: use it with --waveform sinusoid"
        )
    search = Nsga2Settings(**given, seed=settings.seed)
    with elapsed("front"):
        front = make_front(content, settings, options.direction)
        nominal = nominal_gaits(content, settings, options.direction)
    comparison, compared = None, {}
    if options.method == NSGA2:
        comparison = _searched(front, search)
        front = replaced(front, comparison.front)
        compared = {name: value for name, value in vars(comparison).items() if name != "front"}
    if figure is not None:
        from worm_model.analysis.plot_style import save_figure  # here: matplotlib loads slowly
        from worm_optimizer.report.front_plots import front_figure

        save_figure(front_figure(front, front.three), figure)
    limits = {
        name: value for name, value in asdict(settings.limits).items() if math.isfinite(value)
    }
    uncertainty = description(content)
    print_result(
        options,
        {
            **front_json(front, nominal),
            "method": options.method,
            **compared,
            "uncertainty": uncertainty,
            "limits": limits,
            "waveform": settings.waveform.value,
            "conditions": asdict(settings.conditions),
        },
        describe(front, nominal, uncertainty, comparison),
    )


def _searched(front: RobustFront, search: Nsga2Settings) -> Comparison:
    """Search the front with NSGA-II, and return its comparison with the exact front."""
    from worm_optimizer.search import (
        nsga2,
    )  # here: its import is slow, and the exact front does not need it

    found = nsga2.nsga2_front(front.exact.task, search, ProgressLine("NSGA-II"))
    if not len(found):
        raise InputError(
            "NSGA-II found no gait that gains a groove in every cycle: raise --population or --generations"
        )
    return nsga2.compared(front.exact, found)


main = executable(_parser, _optimize)
