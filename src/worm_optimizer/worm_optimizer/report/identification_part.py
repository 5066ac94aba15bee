# SPDX-License-Identifier: Apache-2.0
"""What a report shows of an identification: its parameter file, its own report, the fits of the bench tests."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

from worm_model.commands.command_line import InputError, Parser
from worm_model.identification import bellows, fin
from worm_model.identification.bellows import Array, BellowsFit, fit_bellows
from worm_model.identification.fin import FinFit, fit_fin
from worm_model.identification.identification_errors import IdentificationError
from worm_model.identification.identification_report import FIGURE_TITLES, FIGURES, PAGE
from worm_model.identification.inputs import read_bench_test
from worm_model.parameters import ParameterFile, load_parameter_file

_SUFFIX = ".png"
_Fit = TypeVar("_Fit")


@dataclass(frozen=True)
class Identification:
    """Parts that are None or empty are left out.

    ``content`` is a parameter file and ``source`` where it lies; ``bellows_fit`` and ``fin_fit`` are fits of bench
    tests; ``text`` is the report that identification wrote, and ``figures`` its images (PNG) by title.
    """

    content: ParameterFile | None = None
    source: str = ""
    bellows_fit: BellowsFit | None = None
    fin_fit: FinFit | None = None
    text: str = ""
    figures: Mapping[str, bytes] = field(default_factory=dict)


def add_identification(parser: Parser) -> None:
    """Adds what names the parts of an identification."""
    parser.add_argument(
        "--identification",
        type=Path,
        action="append",
        default=[],
        metavar="PATH",
        help="a parameter file that identify has written, or the folder of its report; once for each",
    )
    parser.add_argument("--bellows", type=Path, metavar="CSV", help="compression_m, force_N")
    parser.add_argument("--fin", type=Path, metavar="CSV", help="displacement_m, force_N")


def identification_of(options: argparse.Namespace) -> Identification | None:
    """The parts that are asked for, None where none is; raises InputError or ParameterError if one is no good."""
    folders = [path for path in options.identification if path.is_dir()]
    files = [path for path in options.identification if not path.is_dir()]
    if not (folders or files or options.bellows or options.fin):
        return None
    if len(folders) > 1 or len(files) > 1:
        raise InputError("--identification: give one parameter file and one folder at most")
    text, figures = _read_folder(folders)
    return Identification(
        content=load_parameter_file(str(files[0])) if files else None,
        source=str(files[0]) if files else "",
        bellows_fit=_fit("--bellows", options.bellows, bellows.COLUMNS, fit_bellows),
        fin_fit=_fit("--fin", options.fin, fin.COLUMNS, fit_fin),
        text=text,
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
    """Text and figures of a report of identify, the bench tests first."""
    if not folders:
        return "", {}
    folder = folders[0]
    page = folder / PAGE
    if not page.is_file():
        raise InputError(
            f"--identification {folder}: has no {PAGE}; name the folder that identify --report wrote"
        )
    images = {path.stem: path for path in sorted((folder / FIGURES).glob(f"*{_SUFFIX}"))}
    ordered = [name for name in FIGURE_TITLES if name in images]
    ordered += [name for name in images if name not in FIGURE_TITLES]
    figures = {
        FIGURE_TITLES.get(name, name.replace("_", " ")): images[name].read_bytes()
        for name in ordered
    }
    return page.read_text(encoding="utf-8"), figures
