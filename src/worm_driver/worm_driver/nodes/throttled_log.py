# SPDX-License-Identifier: Apache-2.0
"""Rate-limited logging of events that may occur hundreds of times a second."""

import time
from collections.abc import Callable
from typing import Protocol

#: number of lines that may be logged at once
_BURST = 5
#: s, time after which one more line may be logged
_PERIOD = 1.0


class Logger(Protocol):
    """Part of rclpy's logger that this module uses."""

    def warning(self, message: str) -> object:
        """Log a warning."""


class ThrottledLog:
    """Logger of at most 5 lines at once, then 1 line a second. A line reports how many were omitted before it.

    Args:
        logger: logger of a node.
        clock: returns the time, s, monotonic.
    """

    def __init__(self, logger: Logger, clock: Callable[[], float] = time.monotonic):
        self._logger = logger
        self._clock = clock
        self._allowed = float(_BURST)
        self._at = clock()
        self._omitted = 0

    def warning(self, message: str) -> None:
        """Log a warning, or count it as omitted."""
        if line := self._admit(message):
            self._logger.warning(line)

    def _admit(self, message: str) -> str:
        """Return the line to log; empty if it is omitted."""
        now = self._clock()
        self._allowed = min(_BURST, self._allowed + (now - self._at) / _PERIOD)
        self._at = now
        if self._allowed < 1.0:
            self._omitted += 1
            return ""
        more = f" ({self._omitted} lines before this one were omitted)" if self._omitted else ""
        self._allowed, self._omitted = self._allowed - 1.0, 0
        return message + more
