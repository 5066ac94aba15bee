# SPDX-License-Identifier: Apache-2.0
"""Writer of a report: one self-contained page from `report.html.jinja`, and each figure as PNG and PDF."""

from __future__ import annotations

import base64
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup
from matplotlib.figure import Figure

from worm_model.analysis.plot_style import save_png_and_pdf
from worm_model.parameters import (
    FITTED_WITH_FORM,
    KEYS,
    PAPER,
    SYMBOLS,
    UNITS,
    ParameterFile,
    load_parameter_file,
)
from worm_msgs.conditions import LEVEL
from worm_optimizer.report import agreement
from worm_optimizer.report.front_plots import measured_front_figure, price_figure
from worm_optimizer.report.optimisation import Optimisation
from worm_optimizer.report.recorded_gait import RecordedGait
from worm_optimizer.report.run_figures import RUN_FIGURES

PAGE = "report.html"
REPORT_SUFFIX = "_report"  # end of the name of a report's folder
_TEMPLATE = "report.html.jinja"
# Entries at the top of the page. Each shows the first available one of these keys of the provenance.
_FACTS = {
    "date": ("recorded_at",),
    "robot": ("note.robot", "imported_from", "host"),
    "conditions": ("conditions",),
    "seed": ("seed",),
}


@dataclass(frozen=True)
class Report:
    """Content of a report. Sections whose content is None or empty are omitted.

    Attributes:
        title: title of the page.
        gaits: recorded gaits.
        optimisation: front and price of robustness.
        note: reason why a requested optimisation is missing.
        identification: path of a parameter file that identify has written.
    """

    title: str
    gaits: Sequence[RecordedGait] = ()
    optimisation: Optimisation | None = None
    note: str = ""
    identification: str = ""


@dataclass(frozen=True)
class Picture:
    """Figure in the page: its PNG in base64 (``data``) and its ``caption``."""

    data: str
    caption: str


class _Pictures:
    """Folder in which figures are saved as PNG and PDF."""

    def __init__(self, folder: Path) -> None:
        folder.mkdir()
        self._folder = folder

    def save(self, name: str, figure: Figure, caption: str) -> Picture:
        """Save one figure as PNG and PDF, without a creation time in the files, and return it for the page."""
        save_png_and_pdf(figure, self._folder / name)
        return _picture((self._folder / f"{name}.png").read_bytes(), caption)


def build_report(report: Report, folder: Path) -> Path:
    """Write a report into a new folder and return the path of its page."""
    folder.mkdir(parents=True)
    pictures = _Pictures(folder / "figures")
    environment = Environment(
        loader=PackageLoader("worm_optimizer", "report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {
        "mm": _millimetres,
        "title_of": agreement.title_of,
        "percent": agreement.percent,
        "expected_range": agreement.expected_range,
        "margin_text": agreement.margin_text,
        "symbol": _symbol,
    }
    content = {
        "report": report,
        "headline": agreement.headline(report.gaits) if report.gaits else "",
        "good": all(row.agrees for g in report.gaits for row in agreement.agreements(g))
        and not any(gait.early_end for gait in report.gaits),
        "facts": _facts(report.gaits),
        "quantities": agreement.QUANTITIES,
        "agreements": [row for gait in report.gaits for row in agreement.agreements(gait)],
        "cap": agreement.LEAST_DISAGREEMENT,
        "orders": list(agreement.orders(report.gaits).values()),
        "failures": list(_failures(report.gaits)),
        "front": _front_pictures(report, pictures),
        "warned": any(e.level == "warning" for gait in report.gaits for e in gait.events),
        "runs": [_run(gait, number, pictures) for number, gait in enumerate(report.gaits, 1)],
        "identification": _identification(report.identification),
    }
    text = environment.get_template(_TEMPLATE).render(content)
    path = folder / PAGE
    path.write_text(text, encoding="utf-8")
    return path


def report_name(names: Sequence[str]) -> str:
    """Return the name of a report's folder: ``A_report``, ``A_with_B_report``, or ``A_with_2_others_report``."""
    first, *others = names
    added = f"{len(others)}_others" if len(others) > 1 else "".join(others)
    return f"{first}_with_{added}{REPORT_SUFFIX}" if added else f"{first}{REPORT_SUFFIX}"


def _facts(gaits: Sequence[RecordedGait]) -> dict[str, str]:
    """Return the entries at the top of the page by name: those of `_FACTS`, and the origin of the parameters.

    The entry of the conditions is omitted on level ground. Without gaits, there are no entries.
    """
    facts = {}
    for name, keys in _FACTS.items():
        values = [
            next((gait.provenance[key] for key in keys if key in gait.provenance), "")
            for gait in gaits
        ]
        facts[name] = ", ".join(dict.fromkeys(value for value in values if value))
    facts["date"] = _span_of_dates(facts["date"])
    if facts["conditions"] == str(LEVEL):
        facts.pop("conditions")
    facts["parameters"] = ", ".join(dict.fromkeys(gait.parameter_source for gait in gaits))
    return {name: text or "not recorded" for name, text in facts.items()} if gaits else {}


def _span_of_dates(text: str) -> str:
    """Return the earliest and the latest of some dates (ISO 8601, UTC), with a resolution of a minute."""
    dates = sorted(date[:16].replace("T", " ") for date in text.split(", ") if date)
    return " to ".join(dict.fromkeys((*dates[:1], *dates[-1:]))) + (" UTC" if dates else "")


def _failures(gaits: Sequence[RecordedGait]) -> Iterator[str]:
    """Yield a line for each early end, disagreeing value, changed order of the gaits, missing value, and error."""
    for gait in gaits:
        if gait.early_end:
            yield f"{agreement.title_of(gait.name)}: {gait.early_end}"
    for row in (row for gait in gaits for row in agreement.agreements(gait)):
        if row.agrees is False:
            name = agreement.QUANTITIES[row.quantity].name
            difference = agreement.percent(row.difference)
            yield f"{agreement.title_of(row.gait)}: {name} differs from the expected value by {difference}"
    yield from (text for same, text in agreement.orders(gaits).values() if same is False)
    for gait in gaits:
        yield from (f"{agreement.title_of(gait.name)}: {reason}" for reason in gait.missing)
        for event in gait.events:
            if event.level == "error":
                when = f" at {event.time:.2f} s" if math.isfinite(event.time) else ""
                yield f"{agreement.title_of(gait.name)}, {event.source}{when}: {event.text}"


def _front_pictures(report: Report, pictures: _Pictures) -> list[Picture]:
    optimisation = report.optimisation
    if optimisation is None:
        return []
    front = optimisation.front
    return [
        pictures.save(
            "front",
            measured_front_figure(front, report.gaits),
            "The exact robust front (with the margin), the values expected of the gaits without the margin (95 %), and "
            "the measured values (lowest and highest cycle) with the cost of transport.",
        ),
        pictures.save(
            "price_of_robustness",
            price_figure(optimisation.price),
            f"The lowest cost of transport over the margin. Margin of the front: {front.reason}.",
        ),
    ]


def _run(gait: RecordedGait, number: int, pictures: _Pictures) -> dict[str, Any]:
    phases = gait.replay.states["groove_phase"]
    notes = [event for event in gait.events if event.level == "note"]
    return {
        "gait": gait,
        "phase": float(phases[-1]) if len(phases) else math.nan,
        "pictures": [
            pictures.save(f"run_{number}_{name}", draw(gait), caption)
            for name, (draw, caption) in RUN_FIGURES.items()
        ],
        "complaints": [event for event in gait.events if event.level != "note"],
        "notes": notes,
    }


def _identification(path: str) -> dict[str, Any] | None:
    if not path:
        return None
    content = load_parameter_file(path)
    return {
        "source": path,
        "one_sided_cable": content.parameters.one_sided_cable,
        "rows": list(_parameter_rows(content)),
        "provenance": dict(content.provenance),
    }


def _parameter_rows(content: ParameterFile) -> Iterator[tuple[str, ...]]:
    """Yield key, symbol, value, interval, paper's value and unit of each parameter."""
    values, paper = content.parameters.as_dict(), PAPER.as_dict()
    # The paper's power model is another one than that of a cable that cannot push.
    other = FITTED_WITH_FORM if content.parameters.one_sided_cable else ()
    for key in KEYS:
        low, high = content.intervals.get(key, (math.nan, math.nan))
        interval = f"{low:.5g} to {high:.5g}" if math.isfinite(low) else "not identified"
        text = "–" if key in other else f"{paper[key]:.5g}"
        yield key, SYMBOLS[key], f"{values[key]:.5g}", interval, text, UNITS[key]


def _picture(png: bytes, caption: str) -> Picture:
    return Picture(base64.b64encode(png).decode(), caption)


def _symbol(text: str) -> Markup:
    """Return a symbol such as ``p_sw`` as HTML, with its index as a subscript."""
    base, _, index = text.partition("_")
    return Markup("{}<sub>{}</sub>").format(base, index) if index else Markup(base)


def _millimetres(value: float, decimals: int = 2) -> str:
    """Return a length in m as a number of millimetres, or a dash if it is not finite."""
    return f"{1e3 * value:.{decimals}f}" if math.isfinite(value) else "–"
