# SPDX-License-Identifier: Apache-2.0
"""What all command lines share: exit status, one-line errors, progress, JSON.

Exit status 0: done; 2: bad input, one line on standard error says what and how to mend it; 1: anything
else. Standard output holds the result alone, progress and logs go to standard error.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, NoReturn

from worm_model.bags.bag_errors import BagError
from worm_model.gait import GaitError
from worm_model.parameters import ParameterError

DONE, FAILED, BAD_INPUT = 0, 1, 2


class InputError(ValueError):
    """What the user gave cannot be used; the message is one line that says why and what to do."""


class Parser(argparse.ArgumentParser):
    """A parser whose complaint is one line."""

    def error(self, message: str) -> NoReturn:
        """Prints the complaint and leaves with status 2."""
        self.exit(BAD_INPUT, f"{self.prog}: {message}; see {self.prog} --help\n")


def run_command(
    parser: argparse.ArgumentParser,
    command: Callable[[argparse.Namespace], int | None],
    arguments: list[str] | None = None,
) -> int:
    """Parses, runs, and turns what goes wrong into the exit status; returns it."""
    options = parser.parse_args(arguments)
    try:
        return command(options) or DONE
    except (InputError, GaitError, ParameterError, BagError, FileExistsError) as error:
        print(f"{parser.prog}: {one_line(error)}", file=sys.stderr)  # noqa: T201
        return BAD_INPUT
    except BrokenPipeError:
        sys.stderr.close()  # the reader of the output has gone, as `head` does
        return FAILED
    except OSError as error:  # a full disk, no permission
        print(f"{parser.prog}: {one_line(error)}", file=sys.stderr)  # noqa: T201
        return FAILED
    except KeyboardInterrupt:
        print(f"{parser.prog}: cancelled", file=sys.stderr)  # noqa: T201
        return FAILED


def one_line(error: BaseException) -> str:
    """The message of an error without line breaks."""
    if isinstance(error, FileExistsError):
        return f"{error.filename}: exists already; give another name, nothing is overwritten"
    return " ".join(str(error).split())


def add_parameters(parser: argparse.ArgumentParser) -> None:
    """Adds --parameters, which every command takes."""
    parser.add_argument(
        "--parameters",
        default="",
        metavar="FILE",
        help="parameter file (YAML); default: the paper's",
    )


def number(text: str) -> float:
    """A finite number, for argparse."""
    value = float(text)
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"{text} is not a finite number")
    return value


def new_file(path: str) -> Path:
    """A path that does not exist yet in a folder that does; raises `InputError` otherwise."""
    target = Path(path)
    if target.exists():
        raise InputError(f"{path}: exists already; give another name, nothing is overwritten")
    if not target.parent.is_dir():
        raise InputError(f"{path}: its folder {target.parent} does not exist; make it first")
    return target


def print_json(content: Any) -> None:
    """Prints one JSON object; what is not a finite number becomes null, as JSON knows no NaN."""
    json.dump(_finite(content), sys.stdout, allow_nan=False)
    sys.stdout.write("\n")


def _finite(content: Any) -> Any:
    if isinstance(content, dict):
        return {key: _finite(value) for key, value in content.items()}
    if isinstance(content, list | tuple):
        return [_finite(value) for value in content]
    if hasattr(content, "item") and getattr(content, "ndim", 0) == 0:
        content = content.item()  # a numpy scalar
    if hasattr(content, "tolist"):
        return _finite(content.tolist())
    if isinstance(content, float) and not math.isfinite(content):
        return None
    return content


class Progress:
    """A progress line on standard error: a bar on a terminal, a line every tenth elsewhere."""

    WIDTH = 40

    def __init__(self, title: str) -> None:
        self._title = title
        self._terminal = sys.stderr.isatty()
        self._shown = -1

    def __call__(self, fraction: float) -> None:
        """Shows that a fraction between 0 and 1 is done."""
        step = int(fraction * (100 if self._terminal else 10))
        if step == self._shown:
            return
        self._shown = step
        if self._terminal:
            bar = "#" * round(fraction * self.WIDTH)
            end = "\n" if fraction >= 1.0 else ""
            sys.stderr.write(f"\r{self._title} [{bar:<{self.WIDTH}}] {fraction:4.0%}{end}")
        else:
            sys.stderr.write(f"{self._title}: {fraction:.0%}\n")
        sys.stderr.flush()
