# SPDX-License-Identifier: Apache-2.0
"""Log lines about what may happen hundreds of times a second: a few, then one a second."""

import time
from collections.abc import Callable
from typing import Protocol

#: lines that may follow each other at once, and s after which one more may
_BURST = 5
_PERIOD = 1.0


class Logger(Protocol):
    """The part of rclpy's logger that is used."""

    def warning(self, message: str) -> object:
        """Log a warning."""

    def error(self, message: str) -> object:
        """Log an error."""


class ThrottledLog:
    """Logs a few lines, then at most one a second, with the number of lines that were left out since the last one.

    Args:
        logger: of a node.
        clock: s, monotonic.
    """

    def __init__(self, logger: Logger, clock: Callable[[], float] = time.monotonic):
        self._logger = logger
        self._clock = clock
        self._allowed = float(_BURST)
        self._at = clock()
        self._left_out = 0

    def warning(self, message: str) -> None:
        """Log a warning, or count it."""
        if line := self._admit(message):
            self._logger.warning(line)

    def error(self, message: str) -> None:
        """Log an error, or count it."""
        if line := self._admit(message):  # rclpy wants one severity for each place in the source
            self._logger.error(line)

    def _admit(self, message: str) -> str:
        """Return the line to be logged; empty where it is only counted."""
        now = self._clock()
        self._allowed = min(_BURST, self._allowed + (now - self._at) / _PERIOD)
        self._at = now
        if self._allowed < 1.0:
            self._left_out += 1
            return ""
        more = f" ({self._left_out} more lines like this were left out)" if self._left_out else ""
        self._allowed, self._left_out = self._allowed - 1.0, 0
        return message + more
