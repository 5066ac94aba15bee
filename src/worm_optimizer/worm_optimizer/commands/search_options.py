# SPDX-License-Identifier: Apache-2.0
"""Shared parts of the commands that search gaits: options generated from `SettingRow`s, and a table of gaits."""

from __future__ import annotations

import argparse
import math
from collections.abc import Mapping, Sequence
from itertools import groupby
from typing import Any

from worm_model.commands.command_line import InputError, Parser, number
from worm_model.gait import Profile
from worm_model.text_table import labelled, text_table
from worm_msgs.conditions import CONDITION_ROWS
from worm_optimizer.gait_prediction import Prediction
from worm_optimizer.search import search_settings


def add_scan_options(parser: Parser) -> None:
    """Add the options of all searches: direction, settings of a margin scan, figure, JSON output, parameter file."""
    parser.add_direction()
    _add_settings(parser, search_settings.SCAN_SETTINGS)
    parser.add_figure()
    parser.add_json()
    parser.add_parameters()


def add_limit_options(parser: Parser) -> None:
    """Add the options for the box of gaits and the limits of the robot."""
    _add_settings(parser, search_settings.LIMIT_SETTINGS)


def add_campaign_options(parser: Parser) -> None:
    """Add the options for the settings of a front. `start.add_robot` adds those for the conditions."""
    rows = (row for row in search_settings.SETTINGS if row.name not in CONDITION_ROWS)
    _add_settings(parser, tuple(rows))


def add_front_options(parser: Parser) -> None:
    """Add the options of `add_scan_options`, and those for the other settings of a front."""
    add_scan_options(parser)
    _add_settings(parser, search_settings.FRONT_SETTINGS)


def chosen_settings(options: argparse.Namespace) -> search_settings.Settings:
    """Return the settings that the options describe. Raises `InputError` if they are inadmissible."""
    values: dict[str, Any] = {}
    for option, rows in _by_option(search_settings.SETTINGS):
        value = getattr(options, option.replace("-", "_"), None)
        if value is not None:
            values |= dict(
                zip(
                    (row.name for row in rows),
                    value if len(rows) > 1 else [value],
                    strict=True,
                )
            )
    settings = search_settings.settings_of(values)
    margins = {"--margin": settings.margin, "--margin-n": settings.margin_force}
    given = [f"{option} {value:g}" for option, value in margins.items() if value is not None]
    if given and settings.robustness is not search_settings.Robustness.MARGIN:
        raise InputError(
            f"{given[0]} has no effect with --robustness {settings.robustness.value}: remove one of them"
        )
    return settings


def _add_settings(parser: Parser, chosen: tuple[search_settings.SettingRow, ...]) -> None:
    for option, rows in _by_option(chosen):
        first = rows[0]
        meaning = "; ".join(row.description for row in rows)
        default = " ".join(_as_text(row.default) for row in rows)
        number_kind = int if isinstance(first.default, int) else number
        parser.add_argument(
            f"--{option}",
            type=str if isinstance(first.default, str) else number_kind,
            nargs=len(rows) if len(rows) > 1 else None,
            choices=first.choices or None,
            metavar=("LOW", "HIGH") if len(rows) > 1 else None if first.choices else "VALUE",
            help=f"{meaning} (default: {default})".replace("%", "%%").replace(" (default: )", ""),
        )


def _by_option(
    rows: tuple[search_settings.SettingRow, ...],
) -> list[tuple[str, list[search_settings.SettingRow]]]:
    """Return each option with its rows, in the order of ``rows``. Successive rows may belong to the same option."""
    return [(option, list(group)) for option, group in groupby(rows, lambda row: row.option)]


def _as_text(default: object) -> str:
    if isinstance(default, float):
        return "" if math.isnan(default) else f"{default:g}"
    return str(default)


#: Columns of `gait_table`: n is the mean number of grooves per cycle, φ the groove phase.
_HEADS = (
    "gait",
    "S (mm)",
    "f (Hz)",
    "margin (mm)",
    "speed (mm/s)",
    "nominal (mm/s)",
    "power (W)",
    "COT",
    "n",
    "to edges (mm)",
    "success",
    "any φ",
)


def gait_table(robust: Mapping[str, Prediction], nominal: Mapping[str, Prediction]) -> str:
    """Return a table of robust and nominal gaits, with a line for each gait."""
    rows: list[Sequence[str]] = [_HEADS]
    for kind, gaits in (("robust", robust), ("nominal", nominal)):
        rows += [_row(f"{kind} {name.replace('_', ' ')}", gait) for name, gait in gaits.items()]
    return text_table(rows)


def shape_lines(gaits: Mapping[str, Prediction]) -> list[str]:
    """Return a line with the shape of each gait that is not the paper's sinusoid."""
    shapes = {
        name.replace("_", " "): f"pretension {1e3 * gait.pretension:.2f} mm, contraction share "
        f"{gait.contraction_share:.3f}, {gait.profile}"
        + (f", ramp share {gait.ramp_share:.3f}" if gait.profile is Profile.TRAPEZOID else "")
        for name, gait in gaits.items()
        if not gait.is_sinusoid
    }
    return labelled(shapes).splitlines()


def success_lines(uncertainty: str, warning: str) -> str:
    """Return the meaning of the columns of probabilities, with a warning on a further line if it is not empty."""
    meaning = (
        f"success: share of draws of the parameters ({uncertainty}) in which the robot gains the predicted grooves in "
        "every averaged cycle; any φ: the same at an unknown groove phase"
    )
    return f"{meaning}\nwarning: {warning}" if warning else meaning


def _row(name: str, gait: Prediction) -> Sequence[str]:
    return (
        name,
        f"{1e3 * gait.stroke:.2f}",
        f"{gait.frequency:.4f}",
        f"{1e3 * gait.margin:.2f}",
        f"{1e3 * gait.speed:.3f}",
        f"{1e3 * gait.nominal_speed:.3f}",
        f"{gait.power:.3f}",
        f"{gait.cost_of_transport:.1f}",
        f"{gait.grooves_per_cycle:.2f}",
        f"-{1e3 * gait.stroke_to_lower_edge:.1f} +{1e3 * gait.stroke_to_upper_edge:.1f}",
        f"{gait.success_probability:.3f}",
        f"{gait.success_probability_any_phase:.3f}",
    )
