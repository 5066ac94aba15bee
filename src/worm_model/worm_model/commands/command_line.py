# SPDX-License-Identifier: Apache-2.0
"""Common parts of the commands: those of `worm_msgs.command_parser`, options, output, progress.

Standard output contains only the result. Progress and logs are written to standard error.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from worm_model.errors import InputError, printable
from worm_msgs import command_parser
from worm_msgs.command_parser import BAD_INPUT, DONE, FAILED, notifier, run_command
from worm_msgs.conditions import CONDITION_ROWS
from worm_msgs.gait import FORWARD, GAIT_DEFAULTS, GAIT_MEANINGS, GAIT_UNITS, REVERSE, Profile

__all__ = ["BAD_INPUT", "DONE", "FAILED", "InputError", "notifier", "run_command"]

FIGURES = (".png", ".pdf", ".svg")  # formats of figures


class Parser(command_parser.Parser):
    """Parser with the options that several commands share."""

    def add_number(
        self, name: str, unit: str, meaning: str, default: float | None = None, **more: Any
    ) -> None:
        """Add an option for a finite number; its help includes the default, if there is one."""
        suffix = "" if default is None else f" (default: {default:g})"
        self.add_argument(
            name, type=number, default=default, metavar=unit, help=f"{meaning}{suffix}", **more
        )

    def add_gait(
        self, fields: Iterable[str] = tuple(GAIT_UNITS), *, required: bool = False
    ) -> None:
        """Add an option for each of the ``fields`` of a gait; ``required``: fields without a default are mandatory."""
        for name in fields:
            unit = GAIT_UNITS[name]
            if name == "direction":
                self.add_direction()
                continue
            if name == "profile":
                self.add_argument(
                    "--profile",
                    default=str(Profile.COSINE),
                    choices=[str(profile) for profile in Profile],
                    help=f"{GAIT_MEANINGS[name]} (default: {Profile.COSINE})",
                )
                continue
            needed = required and name not in GAIT_DEFAULTS
            meaning = GAIT_MEANINGS[name] + (f" in {unit}" if unit != "1" else "")
            metavar = unit.upper() if unit != "1" else "X"
            option = f"--{name.replace('_', '-')}"
            self.add_number(option, metavar, meaning, GAIT_DEFAULTS.get(name), required=needed)

    def add_direction(self) -> None:
        """Add --direction."""
        self.add_argument(
            "--direction",
            type=int,
            default=FORWARD,
            choices=(FORWARD, REVERSE),
            help=f"{FORWARD}: forward (default), {REVERSE}: reverse",
        )

    def add_conditions(self, default: float | None = 0.0) -> None:
        """Add an option for each field of `Conditions`; `conditions_of` converts the parsed options."""
        for name, row in CONDITION_ROWS.items():
            metavar = row["unit"].upper().replace("/", "_PER_")
            self.add_number(row["option"], metavar, row["meaning"], default, dest=name)

    def add_figure(self) -> None:
        """Add --figure; see `figure_file`."""
        self.add_argument(
            "--figure", metavar="FILE", help="write a figure too (.png, .pdf or .svg)"
        )

    def add_parameters(self, default: str = "the paper's values") -> None:
        """Add --parameters; ``default`` describes the parameters that are used without the option."""
        self.add_argument(
            "--parameters",
            default="",
            metavar="FILE",
            help=f"parameter file (YAML); default: {default}",
        )

    def add_json(self) -> None:
        """Add --json; see `print_result`."""
        self.add_argument("--json", action="store_true", help="print one JSON object")


def executable(
    parser: Callable[[], argparse.ArgumentParser],
    command: Callable[[argparse.Namespace], int | None],
) -> Callable[[], int]:
    """Return an entry point that runs a command with the arguments of the process."""
    return lambda: run_command(parser(), command)


def number(text: str) -> float:
    """Convert a command-line argument to a finite number; a ``type`` for argparse."""
    value = float(text)
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"{text} is not a finite number")
    return value


def not_negative(text: str) -> float:
    """Convert a command-line argument to a finite number of at least 0; a ``type`` for argparse."""
    value = number(text)
    if value < 0.0:
        raise argparse.ArgumentTypeError(f"{text} is negative")
    return value


def new_file(path: str) -> Path:
    """Return a path that does not exist yet in an existing folder; raise `InputError` otherwise."""
    target = Path(path)
    if target.exists():
        raise InputError(f"{path}: exists already and is not overwritten; give another name")
    if not target.parent.is_dir():
        raise InputError(f"{path}: its folder {target.parent} does not exist; create it first")
    return target


def figure_file(options: argparse.Namespace) -> Path | None:
    """Return the new file of --figure, or None without that option; raise `InputError` if it cannot be created."""
    if options.figure is None:
        return None
    path = new_file(options.figure)
    if path.suffix.lower() not in FIGURES:
        raise InputError(f"--figure {path}: end its name in {', '.join(FIGURES)}")
    return path


def print_result(options: argparse.Namespace, content: dict[str, Any], text: str) -> None:
    """Print a result: ``content`` as JSON with --json, otherwise ``text``."""
    if options.json:
        print_json(content)
    else:
        sys.stdout.write(f"{printable(text)}\n")
    sys.stdout.flush()  # so that later lines on standard error follow it, even in one file


def print_json(content: Any) -> None:
    """Print one JSON object; NaN and infinity become null, because JSON has neither."""
    json.dump(finite(content), sys.stdout, allow_nan=False)
    sys.stdout.write("\n")


def finite(content: Any) -> Any:
    """Return a result for JSON: NaN and infinity become None, and a profile becomes its name."""
    if isinstance(content, dict):
        return {key: finite(value) for key, value in content.items()}
    if isinstance(content, list | tuple):
        return [finite(value) for value in content]
    if isinstance(content, Profile):
        return str(content)
    if hasattr(content, "tolist"):  # of NumPy
        return finite(content.tolist())
    if isinstance(content, float) and not math.isfinite(content):
        return None
    return content


class ProgressLine:
    """Progress with the time left, on standard error: one line on a terminal, otherwise a line for every 10 %."""

    def __init__(self, title: str, clock: Callable[[], float] = time.monotonic) -> None:
        self._title, self._clock = title, clock
        self._terminal = sys.stderr.isatty()
        self._shown = -1
        self._start: tuple[float, float] | None = None  # time in s and fraction of the first call

    def __call__(self, fraction: float) -> None:
        """Show that a fraction between 0 and 1 is done."""
        now = self._clock()
        begin, first = self._start = self._start or (now, fraction)
        step = int(fraction * (100 if self._terminal else 10))
        if step == self._shown:
            return
        self._shown = step
        line = f"{self._title}: {fraction:.0%}"
        if first < fraction < 1.0:
            left = (now - begin) * (1.0 - fraction) / (fraction - first)
            line += f", {duration(left)} left"
        is_over = fraction >= 1.0 or not self._terminal
        # On a terminal, the next line replaces this one.
        sys.stderr.write(f"{line}\n" if is_over else f"{line:<60}\r")
        sys.stderr.flush()


@contextmanager
def elapsed(title: str, every_s: float = 2.0) -> Iterator[None]:
    """Write the time so far to standard error, every ``every_s`` seconds of a computation of unknown duration."""
    done, start = threading.Event(), time.monotonic()

    def report() -> None:
        while not done.wait(every_s):
            sys.stderr.write(f"{title}: computing, {duration(time.monotonic() - start)}\n")
            sys.stderr.flush()

    thread = threading.Thread(target=report, daemon=True)
    thread.start()
    try:
        yield
    finally:
        done.set()
        thread.join()


def duration(seconds: float) -> str:
    """Return a duration as text, such as 2.5 h."""
    for size, name in ((86400.0, "days"), (3600.0, "h"), (60.0, "min")):
        if seconds > 1.5 * size:
            return f"{seconds / size:.1f} {name}"
    return f"{seconds:.0f} s"
