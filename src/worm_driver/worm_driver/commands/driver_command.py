# SPDX-License-Identifier: Apache-2.0
"""What the commands around the camera share: exit status, one-line errors, files that are not overwritten."""

import argparse
import math
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NoReturn

from worm_driver.tracking.tracking_errors import TrackingError

DONE, FAILED, BAD_INPUT = 0, 1, 2


class Parser(argparse.ArgumentParser):
    """A parser whose complaint is one line."""

    def error(self, message: str) -> NoReturn:
        """Prints the complaint and leaves with status 2."""
        self.exit(BAD_INPUT, f"{self.prog}: {message}; see {self.prog} --help\n")


def run_command(
    parser: Parser,
    command: Callable[[argparse.Namespace], None],
    arguments: list[str] | None = None,
) -> int:
    """Parses, runs, and turns what goes wrong into the exit status; returns it."""
    options = parser.parse_args(arguments)
    try:
        command(options)
    except (TrackingError, FileExistsError) as error:
        return _tell(parser, _one_line(error), BAD_INPUT)
    except OSError as error:
        return _tell(parser, _one_line(error), FAILED)
    except KeyboardInterrupt:
        return _tell(parser, "cancelled", FAILED)
    return DONE


def _tell(parser: Parser, text: str, status: int) -> int:
    print(f"{parser.prog}: {text}", file=sys.stderr)  # noqa: T201
    return status


def _one_line(error: BaseException) -> str:
    if isinstance(error, FileExistsError):
        return f"{error.filename}: exists already; give another name, nothing is overwritten"
    return " ".join(str(error).split())


def new_file(text: str) -> Path:
    """A path that does not exist yet in a folder that does, for argparse."""
    path = Path(text)
    if path.exists():
        raise argparse.ArgumentTypeError(
            f"{path} exists already; give another name, nothing is overwritten"
        )
    if not path.absolute().parent.is_dir():
        raise argparse.ArgumentTypeError(f"{path}: its folder does not exist; make it first")
    return path


def positive(text: str) -> float:
    """A finite number above 0, for argparse."""
    value = float(text)
    if not (math.isfinite(value) and value > 0.0):
        raise argparse.ArgumentTypeError(f"{text} must be above 0")
    return value


def say(text: str) -> None:
    """Progress and what is to be told, on standard error."""
    sys.stderr.write(f"{text}\n")
    sys.stderr.flush()
