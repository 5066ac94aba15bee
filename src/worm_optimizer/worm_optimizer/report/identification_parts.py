# SPDX-License-Identifier: Apache-2.0
"""Content of a report's section on identification: parameter file, report of ``identify``, and fits of bench tests."""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

import markdown2
import numpy as np
from matplotlib.figure import Figure

from worm_model.analysis.plot_style import BLUE, GREY, new_figure, symbol
from worm_model.errors import IdentificationError, InputError
from worm_model.identification import bellows, fin
from worm_model.identification.bellows import Array, BellowsFit, fit_bellows
from worm_model.identification.fin import FinFit, fit_fin
from worm_model.identification.inputs import read_bench_test
from worm_model.identification.report.identification_report import (
    FIGURE_TITLES,
    FIGURES,
    FIGURES_HEADING,
    PAGE,
)
from worm_model.parameters import (
    FITTED_WITH_FORM,
    KEYS,
    PAPER,
    SYMBOLS,
    ParameterFile,
    load_parameter_file,
)

_SUFFIX = ".png"
_Fit = TypeVar("_Fit")


@dataclass(frozen=True)
class IdentificationParts:
    """Parts of the section on identification. Parts that are None or empty are omitted.

    Attributes:
        content: content of a parameter file.
        source: path of the parameter file.
        bellows_fit: fit of the bellows bench test.
        fin_fit: fit of the fin bench test.
        report: report written by ``identify``, as HTML.
        figures: images of that report (PNG), by title.
    """

    content: ParameterFile | None = None
    source: str = ""
    bellows_fit: BellowsFit | None = None
    fin_fit: FinFit | None = None
    report: str = ""
    figures: Mapping[str, bytes] = field(default_factory=dict)


def identification_of(options: argparse.Namespace) -> IdentificationParts | None:
    """Read the files that the options --identification, --bellows and --fin name.

    Returns:
        The parts, or None if no option is given.

    Raises:
        InputError: A file is invalid, or several parameter files or folders are given.
        ParameterError: The parameter file is invalid.
    """
    folders = [path for path in options.identification if path.is_dir()]
    files = [path for path in options.identification if not path.is_dir()]
    if not (folders or files or options.bellows or options.fin):
        return None
    if len(folders) > 1 or len(files) > 1:
        raise InputError("--identification: give one parameter file and one folder at most")
    report, figures = _read_folder(folders)
    return IdentificationParts(
        content=load_parameter_file(str(files[0])) if files else None,
        source=str(files[0]) if files else "",
        bellows_fit=_fit("--bellows", options.bellows, bellows.COLUMNS, fit_bellows),
        fin_fit=_fit("--fin", options.fin, fin.COLUMNS, fit_fin),
        report=report,
        figures=figures,
    )


def _fit(
    option: str, path: Path | None, columns: tuple[str, str], fit: Callable[[Array, Array], _Fit]
) -> _Fit | None:
    if path is None:
        return None
    try:
        test = read_bench_test(path, columns)
        return fit(test.x, test.y)
    except IdentificationError as error:
        raise InputError(f"{option} {path}: {error}") from None


def _read_folder(folders: Sequence[Path]) -> tuple[str, dict[str, bytes]]:
    """Return the text (HTML) of a report of ``identify``, and its figures (PNG) by title; empty without a folder.

    The figures are in the order of `FIGURE_TITLES`, followed by figures that it does not contain.
    """
    if not folders:
        return "", {}
    folder = folders[0]
    page = folder / PAGE
    if not page.is_file():
        raise InputError(
            f"--identification {folder}: contains no {PAGE}; give the folder that identify --report wrote"
        )
    images = {path.stem: path for path in sorted((folder / FIGURES).glob(f"*{_SUFFIX}"))}
    ordered = [name for name in FIGURE_TITLES if name in images]
    ordered += [name for name in images if name not in FIGURE_TITLES]
    figures = {
        FIGURE_TITLES.get(name, name.replace("_", " ")): images[name].read_bytes()
        for name in ordered
    }
    return _as_html(page.read_text(encoding="utf-8")), figures


def _as_html(markdown: str) -> str:
    """Return a report in Markdown as HTML. Its title and its section of figures are omitted.

    All headings get level 3.
    """
    text = re.sub(r"\A# .*\n", "", markdown.partition(f"## {FIGURES_HEADING}")[0])
    text = re.sub(r"(?m)^#+ ", "### ", text)
    html = str(markdown2.markdown(text, extras=["code-friendly", "tables"], safe_mode="escape"))
    return html.replace("<table>", '<div class="wide"><table>').replace(
        "</table>", "</table></div>"
    )


def comparable_with_paper(content: ParameterFile) -> list[str]:
    """Return the keys of the parameters that are comparable with the paper.

    Parameters that were fitted with a power model other than the paper's are omitted.
    """
    other = FITTED_WITH_FORM if content.parameters.one_sided_cable else ()
    return [key for key in KEYS if key not in other]


def parameters_figure(content: ParameterFile) -> Figure:
    """Draw the ratio of each identified parameter to the paper's value, with its 95 % interval.

    Parameters that are 0 in the paper or not comparable with it (`comparable_with_paper`) are omitted.
    """
    values, paper = content.parameters.as_dict(), PAPER.as_dict()
    keys = [
        key for key in comparable_with_paper(content) if key in content.intervals and paper[key]
    ]
    ratio = np.array([values[key] / paper[key] for key in keys])
    ends = [np.divide(content.intervals[key], paper[key]) for key in keys]
    bounds = np.reshape(ends, (len(keys), 2))
    figure = new_figure(8.0, 1.2 + 0.32 * len(keys))
    axes = figure.subplots()
    rows = np.arange(len(keys))
    axes.axvline(1.0, color=GREY, linestyle="--", label="the paper's value")
    axes.errorbar(
        ratio,
        rows,
        xerr=[np.maximum(ratio - bounds[:, 0], 0.0), np.maximum(bounds[:, 1] - ratio, 0.0)],
        color=BLUE,
        marker="o",
        linestyle="none",
        capsize=4,
        label="identified, 95 %",
    )
    axes.set_yticks(rows, [f"{key} ({symbol(SYMBOLS[key])})" for key in keys])
    axes.invert_yaxis()
    axes.set_xlabel("identified value / paper's value (1)")
    axes.grid(visible=True, axis="x", linewidth=0.4)
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, frameon=False)
    return figure
