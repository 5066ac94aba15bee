# SPDX-License-Identifier: Apache-2.0
"""The body length that changes count from, as a camera has it."""

_SAMPLES = 30  # at the start, at rest, whose mean it is


class InitialLength:
    """The mean of the first lengths."""

    def __init__(self) -> None:
        self._sum, self._count = 0.0, 0

    def change(self, length: float) -> float:
        """A length (m) minus the initial one, to which the first lengths still add."""
        if self._count < _SAMPLES:
            self._sum += length
            self._count += 1
        return length - self._sum / self._count
