# SPDX-License-Identifier: Apache-2.0
"""Outputs of an identification: page of Markdown with figures, parameter file, and machine-readable summary."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import asdict, fields
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from worm_model.identification.fits.actuation_fit import KEYS as ACTUATION
from worm_model.identification.fits.energy import KEYS as ENERGY
from worm_model.identification.fits.estimate import Estimate
from worm_model.identification.fits.locomotion import SHARED as LOCOMOTION
from worm_model.identification.inputs import Inputs
from worm_model.identification.run_prediction import Errors
from worm_model.identification.stages import Identification
from worm_model.parameters import FORM, KEYS, MADE_BY, PAPER, SYMBOLS, UNITS, ParameterFile
from worm_model.travel_error import PRIOR

PAGE = "report.md"
FIGURES = "figures"
FIGURES_HEADING = "Figures"  # last heading of the page
# Displayed unit and factor by SI unit
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
}


def write_report(
    result: Identification,
    advice: str,
    folder: Path,
    progress: Callable[[float], None] = lambda _: None,
) -> Path:
    """Write report.md and figures/* (PNG and PDF) into a new folder and return the page's path."""
    from worm_model.analysis.plot_style import save_png_and_pdf
    from worm_model.identification.report.identification_figures import all_figures

    folder.mkdir(parents=True)
    pictures = folder / FIGURES
    pictures.mkdir()
    names = []
    expected = 3 * len(result.runs) + 2
    for name, figure in all_figures(result):
        save_png_and_pdf(figure, pictures / name)
        names.append(name)
        progress(len(names) / expected)
    page = folder / PAGE
    page.write_text(text_of(result, advice, names), encoding="utf-8")
    return page


def travel_text(result: Identification) -> str:
    """Return the travel error, and the margins from which it follows, as text."""
    error = result.travel_error
    if error is None:
        return (
            "Travel error: not measured; no run shows the switches of both fins in enough cycles."
        )
    rows = [
        f"{name} {1e3 * measured:+.1f} ({1e3 * predicted:+.1f})"
        for name, (measured, predicted) in result.margins.items()
        if np.isfinite(measured)
    ]
    return (
        f"Travel error (measured minus predicted margin): {1e3 * error.value:+.1f} ± {1e3 * error.sd:.1f} mm. "
        f"Measured margins in mm, in brackets the predicted ones: {', '.join(rows)}."
    )


def text_of(result: Identification, advice: str, figures: list[str]) -> str:
    """Return the page as Markdown."""
    parts = [
        "# Identification",
        result.fit.text,
        _summary(result),
        "## Parameters\n\n" + parameter_table(result.estimates),
        _open_ends(result, advice),
        "## Held-out errors\n\n"
        "Errors of each run with the parameters identified from the *other* runs, in brackets with the paper's table. "
        "Predictions use the exact model with the run's own initial length and the clock offset between camera and "
        "servo from the other runs. x1 is predicted from the measured length, ΔL from the command. Errors are rms "
        "values from the onset until the rear module has passed five ridges. The energy error is that at the end of "
        "this time. Four quantities still depend on the run itself: its initial length, its smoothed length, the "
        "scatter of the grooves, and the forces in the energy fit.\n\n" + error_table(result),
        "## Margins\n\n" + travel_text(result),
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
        f"{count} run{'s' if count > 1 else ''}{when}. Given values: {result.reference.source}. {code_version()}. "
        "Intervals are 95 %."
    )


def parameter_table(estimates: Mapping[str, Estimate]) -> str:
    """Return a table of all parameters with intervals and the paper's values."""
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
    """Return the number of decimals, at most 6, that shows two digits of the interval's half-width.

    If the estimate is not identifiable, a tenth of its value replaces the half-width.
    """
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
    together = f"Strongly correlated estimates: {'; '.join(pairs)}." if pairs else ""
    return "\n\n".join(part for part in (together, f"Recommended measurement: {advice}.") if part)


def error_table(result: Identification) -> str:
    """Return a table of the held-out errors of each run, followed by the errors with the paper's table in brackets."""
    if not result.held_out:
        return "Held-out errors need at least two runs."
    lines = [
        "| run | x1 (mm) | ΔL (mm) | power (W) | energy (%) |",
        "| --- | ---: | ---: | ---: | ---: |",
    ]
    for name, error in result.held_out.items():
        cells = []
        for field, factor, form in ERROR_COLUMNS:
            errors = (error, result.paper[name])
            own, paper = (_number(form, factor * getattr(each, field)) for each in errors)
            cells.append(f"{own} ({paper})")
        lines.append(f"| {name} | {' | '.join(cells)} |")
    return "\n".join(lines)


def _number(form: str, value: float) -> str:
    return form.format(value) if np.isfinite(value) else "unknown"


def nuisance_text(result: Identification) -> str:
    """Return the text on nuisance parameters, with a table of each run's values."""
    locomotion, scatter = result.locomotion, result.locomotion.fit.scatter
    friction, threshold = locomotion.without_dry_friction
    head = (
        "A local fit without dry friction and with even grooves yields "
        f"η = {friction:.1f} N·s/m and p_sw = {threshold * 1e3:.2f} mm. "
        f"The standard deviations between grooves are {scatter.threshold * 1e3:.3f} mm "
        f"of the threshold and {scatter.stiffness * 100:.1f} % of the stiffness. When the slack is taken up, the rear "
        f"module has {1.0 - locomotion.onset:.2f} of its share of the initial rate (1: the centre of mass is at rest; "
        "0: the rear module is at rest, the paper's initial condition). "
        f"Large or correlated residuals of x1 increase the variances by a factor of {locomotion.inflation:.2f}. "
        "The energy of slow gaits hardly determines the clock offset of the power.\n\n"
    )
    lines = [
        "| run | L0 (mm) | P_idle (W) | camera behind servo (ms) | power behind camera (ms) | five ridges |",
        "| --- | ---: | ---: | ---: | ---: | --- |",
    ]
    for index, run in enumerate(result.runs):
        length = 1e3 * locomotion.initial_length[index]
        camera = 1e3 * result.actuation.fit.clock_offset[index]
        power = _number("{:+.1f}", 1e3 * result.energy.clock_offset(run.name))
        reached = f"after {run.traverse.end:.1f} s" if run.traverse.complete else "not reached"
        lines.append(
            f"| {run.name} | {length:.2f} | {run.idle.value:.3f} | {camera:+.1f} | {power} | {reached} |"
        )
    return head + "\n".join(lines)


def _picture(name: str) -> str:
    title = FIGURE_TITLES.get(name, name.replace("_", " "))
    return f"![{title}]({FIGURES}/{name}.png)"


CORRELATED = 0.8  # smallest magnitude of a reported correlation
VERSION = "1.0.0"  # of package.xml


def code_version() -> str:
    """Return a text with the version of this package and the digest of its sources."""
    package = Path(__file__).resolve().parents[2]
    digest = hashlib.sha256()
    for file in sorted(package.rglob("*.py")):
        digest.update(str(file.relative_to(package)).encode() + file.read_bytes())
    return f"worm_model {VERSION}, sources {digest.hexdigest()[:12]}"


def parameter_file(result: Identification, inputs: Inputs) -> ParameterFile:
    """Return values, intervals and provenance of all parameters."""
    intervals = {
        key: (float(e.low), float(e.high))
        for key, e in result.estimates.items()
        if np.isfinite(e.low) and np.isfinite(e.high)
    }
    runs = {
        run.name: {"date": run.recording.date or "not recorded", **run.recording.sources}
        for run in result.runs
    }
    tests = {"bellows": inputs.bellows, "fin": inputs.fin}
    provenance: dict[str, Any] = {
        "made_by": MADE_BY,
        FORM: result.parameters.one_sided_cable,
        "code": code_version(),
        "fit": result.fit.verdict.value,
        "given": result.reference.source,
        "not_identified": {
            key: e.note for key, e in result.estimates.items() if not e.identifiable
        },
        "notes": {key: e.note for key, e in result.estimates.items() if e.identifiable and e.note},
        "bench_tests": {name: test.checksum for name, test in tests.items() if test},
        "runs": runs,
    }
    correlated = {(a, b): round(rho, 4) for a, b, rho in _correlated(result) if {a, b} <= set(KEYS)}
    lengths = [run.length.initial_length for run in result.runs]
    spread = {"initial_length": float(np.std(lengths, ddof=1))} if len(lengths) > 1 else {}
    return ParameterFile(
        result.parameters,
        intervals,
        provenance,
        correlated,
        spread,
        result.travel_error,
    )


def summary(result: Identification) -> dict[str, Any]:
    """Return the result as a JSON object; unknown numbers are NaN or None."""
    return {
        "fit": asdict(result.fit),
        "parameters": {key: e.as_dict() for key, e in result.estimates.items()},
        "travel_error": asdict(result.travel_error or PRIOR),
        "margins": {
            name: {"measured_m": measured, "predicted_m": predicted}
            for name, (measured, predicted) in result.margins.items()
        },
        FORM: result.parameters.one_sided_cable,
        "runs": {name: asdict(error) for name, error in result.held_out.items()}
        or {run.name: dict.fromkeys(error.name for error in fields(Errors)) for run in result.runs},
        "paper": {name: asdict(error) for name, error in result.paper.items()},
        "correlations": [
            {"parameters": [a, b], "correlation": rho} for a, b, rho in correlations(result)
        ],
        "warnings": list(result.warnings),
    }


def _correlated(result: Identification) -> list[tuple[str, str, float]]:
    """Return the known correlations of all pairs of estimates of a stage."""
    stages = (
        (LOCOMOTION, result.locomotion.correlation),
        (ACTUATION, result.actuation.correlation),
        (ENERGY, result.energy.correlation),
    )
    return [
        (names[i], names[j], float(matrix[i, j]))
        for names, matrix in stages
        for i, j in combinations(range(len(names)), 2)
        if np.isfinite(matrix[i, j])
    ]


def correlations(result: Identification) -> list[tuple[str, str, float]]:
    """Return strongly correlated pairs of estimates, strongest first."""
    strong = [pair for pair in _correlated(result) if abs(pair[2]) >= CORRELATED]
    return sorted(strong, key=lambda pair: -abs(pair[2]))
