# SPDX-License-Identifier: Apache-2.0
"""Shared parts of the driver's commands: exit status, one-line errors, no overwritten files."""

import argparse
import math
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NoReturn

from worm_driver.tracking.tracking_errors import TrackingError
from worm_msgs.yaml_file import SettingsFileError

#: Exit statuses.
DONE, FAILED, BAD_INPUT = 0, 1, 2


class Parser(argparse.ArgumentParser):
    """Argument parser with one-line error messages."""

    def error(self, message: str) -> NoReturn:
        """Print the error and exit with status 2."""
        self.exit(BAD_INPUT, f"{self.prog}: {message}; see {self.prog} --help\n")


def run_command(
    parser: Parser,
    command: Callable[[argparse.Namespace], None],
    arguments: list[str] | None = None,
) -> int:
    """Parse the arguments and run the command.

    Returns:
        Exit status: 2 for a TrackingError or an output file that exists, 1 for another OSError or Ctrl-C, else 0. Wrong
        arguments and --help end the program in the parser.
    """
    options = parser.parse_args(arguments)
    try:
        command(options)
    except (TrackingError, SettingsFileError, FileExistsError) as error:
        return _fail(parser, _one_line(error), BAD_INPUT)
    except OSError as error:
        return _fail(parser, _one_line(error), FAILED)
    except KeyboardInterrupt:
        return _fail(parser, "cancelled", FAILED)
    return DONE


def _fail(parser: Parser, text: str, status: int) -> int:
    print(f"{parser.prog}: {text}", file=sys.stderr)  # noqa: T201
    return status


def _one_line(error: BaseException) -> str:
    if isinstance(error, FileExistsError):
        return f"{error.filename}: already exists; use another name"
    return " ".join(str(error).split())


def new_file(text: str) -> Path:
    """Return a path that does not exist yet, in an existing folder. Type of an argument for argparse."""
    path = Path(text)
    if path.exists():
        raise argparse.ArgumentTypeError(f"{path} already exists; use another name")
    if not path.absolute().parent.is_dir():
        raise argparse.ArgumentTypeError(f"{path}: its folder does not exist; create it first")
    return path


def positive(text: str) -> float:
    """Return a finite number above 0. Type of an argument for argparse."""
    value = float(text)
    if not (math.isfinite(value) and value > 0.0):
        raise argparse.ArgumentTypeError(f"{text} must be a finite number above 0")
    return value


def say(text: str) -> None:
    """Print a line on standard error."""
    sys.stderr.write(f"{text}\n")
    sys.stderr.flush()
