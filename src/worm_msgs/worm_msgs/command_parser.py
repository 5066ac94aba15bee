# SPDX-License-Identifier: Apache-2.0
"""Common parts of all command lines: exit status and one-line errors.

The exit status is 0 after success, 2 after bad input, and 1 otherwise. After bad input, one line on standard error
states the mistake and its correction.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from typing import NoReturn

from worm_msgs.input_error import InputError, printable

DONE, FAILED, BAD_INPUT = 0, 1, 2


class Parser(argparse.ArgumentParser):
    """Parser with one-line errors."""

    def error(self, message: str) -> NoReturn:
        """Print the error and exit with status 2."""
        self.exit(BAD_INPUT, f"{self.prog}: {message}; see {self.prog} --help\n")


def run_command(
    parser: argparse.ArgumentParser,
    command: Callable[[argparse.Namespace], int | None],
    arguments: list[str] | None = None,
    bad_input: tuple[type[Exception], ...] = (),
    failures: tuple[type[Exception], ...] = (),
) -> int:
    """Parse the arguments, run the command, and return the exit status.

    ``bad_input`` contains exceptions that are bad input in addition to `InputError` and an output file that exists,
    ``failures`` those that are a failure in addition to OSError.
    """
    rejected: tuple[type[Exception], ...] = (InputError, FileExistsError, *bad_input)
    failed: tuple[type[Exception], ...] = (OSError, *failures)  # a full disk, no permission
    options = parser.parse_args(arguments)
    notify = notifier(parser.prog)
    try:
        return command(options) or DONE
    except rejected as error:
        notify(one_line(error))
        return BAD_INPUT
    except BrokenPipeError:
        sys.stderr.close()  # The process that reads the output, such as `head`, has ended.
        return FAILED
    except failed as error:
        notify(one_line(error))
        return FAILED
    except KeyboardInterrupt:
        notify("cancelled")
        return FAILED


def one_line(error: BaseException) -> str:
    """Return the message of an error without line breaks."""
    if isinstance(error, FileExistsError):
        return f"{error.filename}: exists already and is not overwritten; give another name"
    return " ".join(str(error).split())


def notifier(program: str) -> Callable[[str], None]:
    """Return a function that prints a line, preceded by the program's name, on standard error."""

    def notify(line: str) -> None:
        sys.stderr.write(f"{program}: {printable(line)}\n")

    return notify
