# SPDX-License-Identifier: Apache-2.0
"""Puts a report together: a folder with the page, and each figure as PNG and PDF."""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from matplotlib.figure import Figure

from worm_model.identification.identification_figures import bellows_figure, fin_figure
from worm_optimizer.report import page
from worm_optimizer.report.front_figures import draw_measured_front, draw_price_of_robustness
from worm_optimizer.report.identification_part import Identification
from worm_optimizer.report.optimisation import Optimisation
from worm_optimizer.report.parameter_figures import draw_parameters
from worm_optimizer.report.recorded import RecordedGait
from worm_optimizer.report.run_figures import RUN_FIGURES
from worm_optimizer.report.verdict import orders
from worm_optimizer.search.certificate import MAP, NSGA2

PAGE = "report.html"
_SOURCES = {NSGA2: "of NSGA-II", MAP: "of the exhaustive map"}
_DPI = 130


@dataclass(frozen=True)
class Report:
    """What a report is made of; parts that are None or empty are left out.

    ``note`` says why there is no optimisation, where one was asked for.
    """

    title: str
    gaits: Sequence[RecordedGait] = ()
    optimisation: Optimisation | None = None
    note: str = ""
    identification: Identification | None = None


def build_report(report: Report, folder: Path) -> Path:
    """Writes a report into a new folder and returns the page; raises FileExistsError if the folder is there."""
    folder.mkdir(parents=True)
    text = page.write_page(report.title, _sections(report, folder / "figures"))
    path = folder / PAGE
    path.write_text(text, encoding="utf-8")
    return path


def _sections(report: Report, figures: Path) -> Iterator[str]:
    figures.mkdir()
    if report.gaits:
        yield page.summary_section(report.gaits, orders(report.gaits), report.note)
    if report.optimisation is not None:
        yield from _optimisation_section(report.optimisation, report.gaits, figures)
    for number, gait in enumerate(report.gaits, 1):
        drawn = (
            _saved(draw(gait), figures / f"run_{number}_{name}", caption)
            for name, (draw, caption) in RUN_FIGURES.items()
        )
        yield page.run_section(gait, drawn)
    if report.identification is not None:
        yield from _identification_sections(report.identification, figures)


def _optimisation_section(
    optimisation: Optimisation, gaits: Sequence[RecordedGait], figures: Path
) -> Iterator[str]:
    yield page.heading("Robust front and price of robustness", optimisation.note)
    yield _saved(
        draw_measured_front(optimisation.front, gaits),
        figures / "front",
        f"The robust front ({_SOURCES[optimisation.front.source]}, with the margin), what was expected of the gaits "
        "without the margin (95 %), and what was measured (lowest and highest cycle), with its cost of transport.",
    )
    yield _saved(
        draw_price_of_robustness(optimisation.price),
        figures / "price_of_robustness",
        f"The lowest cost of transport over the margin. The front's margin: {optimisation.front.reason}.",
    )


def _identification_sections(identification: Identification, figures: Path) -> Iterator[str]:
    content = identification.content
    if content is not None:
        drawn = []
        if content.intervals:
            caption = "Identified parameters with their 95 % intervals, over the paper's values."
            drawn.append(_saved(draw_parameters(content), figures / "parameters", caption))
        yield page.parameter_section(content, identification.source, drawn)
    fits = []
    if identification.bellows_fit is not None:
        caption = "Bellows test: force over compression, and the straight line fitted to it (95 %)."
        fits.append(
            _saved(bellows_figure(identification.bellows_fit), figures / "bellows", caption)
        )
    if identification.fin_fit is not None:
        caption = "Fin test: force over displacement, and the law fitted to it; dotted: its clearance (95 %)."
        fits.append(_saved(fin_figure(identification.fin_fit), figures / "fin", caption))
    if fits:
        yield page.heading("Bench tests")
        yield from fits
    if identification.figures or identification.text:
        yield page.attached_section(
            "The report of the identification", identification.figures, identification.text
        )


def _saved(drawing: Figure, stem: Path, caption: str) -> str:
    """Saves a figure as PNG and PDF, without dates, and returns it as a part of the page."""
    image = io.BytesIO()
    drawing.savefig(image, format="png", dpi=_DPI)
    stem.with_suffix(".png").write_bytes(image.getvalue())
    drawing.savefig(stem.with_suffix(".pdf"), metadata={"CreationDate": None})
    return page.figure(image.getvalue(), caption)
