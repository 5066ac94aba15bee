# SPDX-License-Identifier: Apache-2.0
"""The report of an identification: one page of Markdown and the figures beside it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from worm_model.analysis.plot_style import save_figure
from worm_model.identification.estimate import Estimate, quantile
from worm_model.identification.fingerprint import code_version
from worm_model.identification.identification_figures import all_figures
from worm_model.identification.results import correlations
from worm_model.identification.run_prediction import Errors
from worm_model.identification.stages import Identification
from worm_model.parameters import PAPER, SYMBOLS, UNITS

PAGE = "report.md"
FIGURES = "figures"
FIGURES_HEADING = "Figures"  # the last one of the page
# What tables are written in: unit, factor from SI
SHOWN = {"m": ("mm", 1e3)}
# Columns of errors: field, factor from SI, format
ERROR_COLUMNS = (
    ("x1_rmse", 1e3, "{:.2f}"),
    ("length_rmse", 1e3, "{:.2f}"),
    ("power_rmse", 1.0, "{:.3f}"),
    ("energy_error", 1e2, "{:+.1f}"),
)
FIGURE_TITLES = {
    "bellows": "Bellows test and linear fit",
    "fin": "Fin test and fitted law",
    "search": "J_loc over the switching threshold",
}


def write_report(
    result: Identification,
    advice: str,
    folder: Path,
    progress: Callable[[float], None] = lambda _: None,
) -> Path:
    """Writes report.md and figures/* (PNG and PDF) into a folder that does not exist yet; returns the page's path.

    Raises FileExistsError rather than overwrite anything.
    """
    folder.mkdir(parents=True)
    pictures = folder / FIGURES
    pictures.mkdir()
    names = []
    expected = 3 * len(result.runs) + 3
    for name, figure in all_figures(result):
        for ending in (".png", ".pdf"):
            save_figure(figure, pictures / f"{name}{ending}")
        names.append(name)
        progress(len(names) / expected)
    page = folder / PAGE
    page.write_text(text_of(result, advice, names), encoding="utf-8")
    return page


def text_of(result: Identification, advice: str, figures: list[str]) -> str:
    """The page."""
    parts = [
        "# Identification",
        _summary(result),
        "## Parameters\n\n" + parameter_table(result.estimates),
        _open_ends(result, advice),
        "## Left out one by one\n\n"
        "Each run under the parameters that the *other* runs give, next to the paper's table; the exact model "
        "without any nuisance but the run's own initial length, both columns with the clock offset between camera and "
        "servo that the other runs tell. x1 is predicted under the measured length, ΔL from the command; root mean "
        "squares over the five ridges, the energy's error at their end. Not done anew without the run: its smoothed "
        "length (a fit to this run itself), the scatter of the grooves, and the forces under which the others' energy "
        "is fitted.\n\n" + error_table(result.held_out, result.paper),
    ]
    if result.validation:
        parts.append("## Validation runs\n\n" + error_table(result.validation, {}))
    parts += [
        "## Nuisances\n\n" + nuisance_text(result),
        "## Remarks\n\n" + "\n".join(f"- {text}" for text in result.warnings or ["none"]),
        f"## {FIGURES_HEADING}\n\n" + "\n\n".join(_picture(name) for name in figures),
    ]
    return "\n\n".join(parts) + "\n"


def _summary(result: Identification) -> str:
    dates = sorted({run.recording.date for run in result.runs if run.recording.date})
    when = f", recorded {dates[0]} to {dates[-1]}" if dates else ", of unknown date"
    count = len(result.runs)
    return (
        f"{count} run{'s' if count > 1 else ''}{when}. Given values: {result.reference.source}. {code_version()}, "
        f"seed {result.seed}. Intervals are 95 %."
    )


def parameter_table(estimates: Mapping[str, Estimate]) -> str:
    """All parameters with their intervals, next to the paper's table."""
    lines = [
        "| | | value | 95 % interval | unit | paper | |",
        "| --- | --- | ---: | :---: | --- | ---: | --- |",
    ]
    for key, estimate in estimates.items():
        unit, factor = SHOWN.get(UNITS[key], (UNITS[key], 1.0))
        decimals = _decimals(estimate, factor)
        value = f"{estimate.value * factor:.{decimals}f}"
        if estimate.identifiable:
            interval = (
                f"{estimate.low * factor:.{decimals}f} … {estimate.high * factor:.{decimals}f}"
            )
        else:
            interval = "not identified"
        paper = f"{getattr(PAPER, key) * factor:g}"
        lines.append(
            f"| {SYMBOLS[key]} | {key} | {value} | {interval} | {unit} | {paper} | {estimate.note} |"
        )
    return "\n".join(lines)


def _decimals(estimate: Estimate, factor: float) -> int:
    """As many as the interval's width leaves meaning to: two digits of its half."""
    half = (
        estimate.spread * factor if estimate.identifiable else abs(estimate.value * factor) / 10.0
    )
    decimals = 0
    while half < 9.95 and decimals < 6:
        half, decimals = half * 10.0, decimals + 1
    return decimals


def _open_ends(result: Identification, advice: str) -> str:
    pairs = [
        f"{SYMBOLS.get(a, a)} and {SYMBOLS.get(b, b)} {rho:+.2f}"
        for a, b, rho in correlations(result)
    ]
    together = f"Estimates that move together (correlation): {'; '.join(pairs)}." if pairs else ""
    return "\n\n".join(part for part in (together, f"What next: {advice}.") if part)


def error_table(errors: Mapping[str, Errors], paper: Mapping[str, Errors]) -> str:
    """Errors of each run; in brackets those of the paper's table."""
    if not errors:
        return "One run alone: none can be left out."
    lines = [
        "| run | x1 (mm) | ΔL (mm) | power (W) | energy (%) |",
        "| --- | ---: | ---: | ---: | ---: |",
    ]
    for name, error in errors.items():
        cells = [
            _number(form, factor * getattr(error, field))
            + (f" ({_number(form, factor * getattr(paper[name], field))})" if name in paper else "")
            for field, factor, form in ERROR_COLUMNS
        ]
        lines.append(f"| {name} | {' | '.join(cells)} |")
    return "\n".join(lines)


def _number(form: str, value: float) -> str:
    return form.format(value) if np.isfinite(value) else "not seen"


def nuisance_text(result: Identification) -> str:
    """Friction, scatter and weights that are no parameters, and each run's own numbers."""
    locomotion, scatter = result.locomotion, result.locomotion.fit.scatter
    head = (
        "Without dry friction, as J_loc is printed, "
        f"η = {locomotion.as_printed[0]:.1f} N·s/m and p_sw = {locomotion.as_printed[1] * 1e3:.2f} mm. "
        f"Grooves differ by {scatter.threshold * 1e3:.3f} mm "
        f"in threshold and {scatter.stiffness * 100:.1f} % in stiffness (standard deviations). When the slack is taken "
        f"up, the rear module has {1.0 - locomotion.onset:.2f} of its share of the body's first rate (1: the centre of "
        "mass rests, as of a robot at rest; 0: the rear module rests, as the paper's initial values have it). "
        f"Residuals of x1 weigh {locomotion.inflation:.2f} times white noise of the camera.\n\n"
    )
    lines = [
        "| run | L0 (mm) | P_idle (W) | camera behind servo (ms) | power behind camera (ms) | five ridges |",
        "| --- | ---: | ---: | ---: | ---: | --- |",
    ]
    clocks = zip(result.actuation.fit.clock_offset, result.actuation.clock_deviation, strict=True)
    for run, length, clock in zip(result.runs, locomotion.initial_length, clocks, strict=True):
        camera, power = _milliseconds(*clock), _milliseconds(*result.power_clock(run.name))
        reached = f"after {run.traverse.end:.1f} s" if run.traverse.complete else "not reached"
        lines.append(
            f"| {run.name} | {length * 1e3:.2f} | {run.idle.value:.3f} | {camera} | {power} | "
            f"{reached} |"
        )
    return head + "\n".join([*lines, "", delay_text(result.camera_delay)])


def delay_text(delay: Estimate) -> str:
    """What the clocks say of the tracker's delay."""
    if not delay.identifiable:
        return f"Delay of the camera: not told; {delay.note}."
    low, value, high = (1e3 * x for x in (delay.low, delay.value, delay.high))
    return f"Delay of the camera: {value:.1f} ms ({low:.1f} … {high:.1f}); {delay.note}."


def _milliseconds(offset: float, deviation: float) -> str:
    """A clock offset with its 95 % interval, if the data tell it."""
    if not np.isfinite(deviation):
        return "not told"
    return f"{offset * 1e3:+.1f} ± {quantile(np.inf) * deviation * 1e3:.1f}"


def _picture(name: str) -> str:
    title = FIGURE_TITLES.get(name, name.replace("_", " "))
    return f"![{title}]({FIGURES}/{name}.png)"
