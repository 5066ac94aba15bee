# SPDX-License-Identifier: Apache-2.0
"""Shared parts of the driver's commands: their exit status, and types of arguments."""

import argparse
import math
import sys
from collections.abc import Callable
from pathlib import Path

from worm_driver.driver_errors import ConfigurationError, DriverError, TrackingError
from worm_msgs import command_parser
from worm_msgs.command_parser import Parser


def run_command(
    parser: Parser,
    command: Callable[[argparse.Namespace], int | None],
    arguments: list[str] | None = None,
) -> int:
    """Run a command like `command_parser.run_command`, with DriverError as a failure.

    A TrackingError or a ConfigurationError is bad input.
    """
    bad_input = (TrackingError, ConfigurationError)
    return command_parser.run_command(parser, command, arguments, bad_input, (DriverError,))


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


def within(low: float, high: float, kind: type[float] = float) -> Callable[[str], float]:
    """Return a type of an argument for argparse: a number from ``low`` to ``high``."""

    def number(text: str) -> float:
        value = kind(text)
        if not low <= value <= high:
            raise argparse.ArgumentTypeError(f"{text} must be {low:g} to {high:g}")
        return value

    return number


def say(text: str) -> None:
    """Print a line on standard error."""
    sys.stderr.write(f"{text}\n")
    sys.stderr.flush()
