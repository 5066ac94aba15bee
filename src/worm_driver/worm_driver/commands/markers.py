# SPDX-License-Identifier: Apache-2.0
"""Command ``markers``: create a PDF of the calibration board or of markers, to print at true scale."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from worm_driver.commands.driver_command import new_file, run_command
from worm_driver.driver_errors import SetupError
from worm_driver.tracking.tracker_setup import TrackerSetup, load_setup
from worm_driver.tracking.vision import Board, marker_image
from worm_msgs.command_parser import Parser

#: Paper sizes: width and height, m.
PAPERS = {"a4": (0.210, 0.297), "letter": (0.2159, 0.2794)}
#: Calibration board: columns and rows of squares, side of a square (m), dictionary. It fits on both papers.
BOARD = (7, 9, 0.025, "DICT_5X5_100")

_INCH = 0.0254
_MARGIN = 0.015  # m; margin of the page, which printers may leave empty
_HEAD = 0.035  # m; height of the title, the ruler and the text below it
_RULER = 0.1  # m; length of the line for checking the scale
_BOARD_PIXELS = 200  # pixels per square of the board
_TEXT = 8  # points; size of the text

Point = tuple[float, float]


def _markers(setup: TrackerSetup) -> list[tuple[int, str]]:
    """Return number and label of each marker of a rig."""
    return [
        (setup.rear.number, "rear module"),
        (setup.front.number, "front module"),
        *(
            (number, f"on the pipe at x {x:g}, y {y:g}, z {z:g} m")
            for number, (x, y, z) in setup.reference.items()
        ),
    ]


class _Sheet:
    """Page with coordinates in m from its lower left corner."""

    def __init__(self, paper: tuple[float, float], title: str, remedy: str) -> None:
        from matplotlib.figure import Figure

        self.figure = Figure(figsize=(paper[0] / _INCH, paper[1] / _INCH))
        self._axes = self.figure.add_axes((0.0, 0.0, 1.0, 1.0))
        self._axes.set(xlim=(0.0, paper[0]), ylim=(0.0, paper[1]))
        self._axes.set_axis_off()
        top = paper[1] - _MARGIN
        self.text(_MARGIN, top - 0.003, title)
        self._ruler(_MARGIN, top - 0.014)
        self.text(
            _MARGIN,
            top - 0.024,
            "Print at 100 %, without fitting to the page, and measure this line: it must be 100.0 mm long.\n"
            f"If it is not, measure a black square and {remedy}.",
        )

    def text(self, x: float, y: float, text: str, **style: Any) -> None:
        self._axes.text(x, y, text, fontsize=style.pop("fontsize", _TEXT), va="center", **style)

    def line(self, xs: Sequence[float], ys: Sequence[float], **style: Any) -> None:
        self._axes.plot(xs, ys, **{"color": "black", "linewidth": 0.4, **style})

    def _ruler(self, x: float, y: float) -> None:
        self.line([x, x + _RULER], [y, y])
        for index in range(11):
            tick = 0.004 if index % 5 == 0 else 0.002
            self.line([x + 0.01 * index] * 2, [y, y + tick])
            if index % 5 == 0:
                self.text(x + 0.01 * index, y + 0.006, f"{index} cm", ha="center", fontsize=6)

    def image(self, image: Any, x: float, y: float, width: float, height: float) -> None:
        """Draw a black and white image with its lower left corner at (x, y)."""
        self._axes.imshow(
            image, cmap="gray", vmin=0, vmax=255, extent=(x, x + width, y, y + height),
            interpolation="none", aspect="auto", zorder=0,
        )  # fmt: skip

    def marker(self, dictionary: str, size: float, number: int, text: str, at: Point) -> None:
        """Draw a marker with its label, its cutting line and the marks of its middle at the edge of the print."""
        x, y = at
        self.image(marker_image(dictionary, number), x, y, size, size)
        low, high, middle, tick = -0.25 * size, 1.25 * size, 0.5 * size, 0.08 * size
        self.line(
            [x + low, x + high, x + high, x + low, x + low],
            [y + low, y + low, y + high, y + high, y + low],
            color="0.6",
            linestyle=(0, (4, 4)),
        )
        for end, inner in ((low, low + tick), (high, high - tick)):
            self.line([x + end, x + inner], [y + middle] * 2)
            self.line([x + middle] * 2, [y + end, y + inner])
        self.text(x - 0.2 * size, y + 1.19 * size, f"{number}  up ↑", fontsize=5)
        self.text(x + 1.2 * size, y + 1.19 * size, "+x →", fontsize=5, ha="right")
        self.text(x - 0.2 * size, y - 0.25 * size - 0.004, f"{number}  {text}", fontsize=5)


def _marker_sheets(options: argparse.Namespace) -> list[_Sheet]:
    setup, paper = load_setup(options.setup), PAPERS[options.paper]
    dictionary, size = setup.dictionary, setup.marker_size
    pitch_x, pitch_y = max(1.6 * size, 0.045), 1.5 * size + 0.012
    columns = int((paper[0] - 2.0 * _MARGIN) / pitch_x)
    rows = int((paper[1] - 2.0 * _MARGIN - _HEAD) / pitch_y)
    if not columns or not rows:
        raise SetupError(f"a marker of {size:g} m does not fit on the paper")
    sheets = []
    for index, (number, text) in enumerate(_markers(setup)):
        row, column = divmod(index % (columns * rows), columns)
        if row == column == 0:
            title = f"{dictionary}, black square {size * 1e3:g} mm"
            sheets.append(_Sheet(paper, title, "set marker_size_m of the setup file to its side"))
        x = _MARGIN + column * pitch_x + 0.25 * size
        y = paper[1] - _MARGIN - _HEAD - (row + 1) * pitch_y + 0.012 + 0.25 * size
        sheets[-1].marker(dictionary, size, number, text, (x, y))
    return sheets


def _board_sheet(options: argparse.Namespace) -> _Sheet:
    columns, rows, square, dictionary = BOARD
    paper = PAPERS[options.paper]
    title = f"calibration board, squares of {square * 1e3:g} mm; glue it to a flat plate"
    sheet = _Sheet(paper, title, "pass its side to calibrate_camera --square-m")
    image = Board(columns, rows, square, dictionary).draw(_BOARD_PIXELS)
    width, height = columns * square, rows * square
    sheet.image(image, (paper[0] - width) / 2.0, _MARGIN - 0.003, width, height)
    return sheet


def _write(path: Path, sheets: Sequence[_Sheet]) -> None:
    from matplotlib.backends.backend_pdf import PdfPages

    with path.open("xb") as stream, PdfPages(stream) as pdf:
        for sheet in sheets:
            pdf.savefig(sheet.figure)


def _parser() -> Parser:
    parser = Parser(prog="markers", description=__doc__)
    what = parser.add_mutually_exclusive_group(required=True)
    what.add_argument(
        "--setup", type=Path, metavar="FILE", help="markers of the rig in this setup file (YAML)"
    )
    what.add_argument("--board", action="store_true", help="calibration board for calibrate_camera")
    parser.add_argument("--output", type=new_file, required=True, metavar="FILE.pdf")
    parser.add_argument("--paper", choices=PAPERS, default="a4", help="paper size (default a4)")
    return parser


def _run(options: argparse.Namespace) -> None:
    sheets = [_board_sheet(options)] if options.board else _marker_sheets(options)
    _write(options.output, sheets)
    sys.stdout.write(f"{options.output}: {len(sheets)} page(s); measure the line after printing\n")


def main(arguments: list[str] | None = None) -> int:
    """Run the command and return the exit status."""
    return run_command(_parser(), _run, arguments)
