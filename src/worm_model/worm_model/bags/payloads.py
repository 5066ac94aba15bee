# SPDX-License-Identifier: Apache-2.0
"""Many messages of one topic in one array of bytes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Bytes = NDArray[np.uint8]
Integers = NDArray[np.int64]


@dataclass(frozen=True)
class Payloads:
    """Messages, each a stretch of a buffer.

    Attributes:
        buffer: shape (bytes,).
        offset: first byte of each message, shape (messages,).
        size: bytes of each, shape (messages,).
        log_time: when each was received, ns since the epoch, shape (messages,).
    """

    buffer: Bytes
    offset: Integers
    size: Integers
    log_time: Integers

    def __len__(self) -> int:
        return len(self.offset)

    def message(self, row: int) -> bytes:
        """One of the messages."""
        start = self.offset[row]
        return self.buffer[start : start + self.size[row]].tobytes()

    def rows(self, chosen: Integers) -> Bytes:
        """Some messages of one size, shape (len(chosen), size)."""
        size = int(self.size[chosen[0]])
        offset = self.offset[chosen]
        first = offset[0]
        if (np.diff(offset) == size).all():  # they lie one behind the other
            return self.buffer[first : first + size * len(chosen)].reshape(len(chosen), size)
        return self.buffer[offset[:, np.newaxis] + np.arange(size)]

    def compact(self) -> Payloads:
        """The same messages in a buffer that holds nothing else."""
        ends = np.cumsum(self.size)
        starts = ends - self.size
        total = int(ends[-1]) if len(ends) else 0
        if total and (self.size == self.size[0]).all():
            alike = self.rows(np.arange(len(self)))
            return Payloads(alike.reshape(-1), starts, self.size, self.log_time)
        source = np.repeat(self.offset - starts, self.size) + np.arange(total)
        return Payloads(self.buffer[source], starts, self.size, self.log_time)


def payloads_of(messages: Sequence[bytes], log_times: Sequence[int]) -> Payloads:
    """Payloads of separate messages."""
    sizes = np.array([len(data) for data in messages], dtype=np.int64)
    buffer = np.frombuffer(b"".join(messages), np.uint8)
    times = np.array(log_times, dtype=np.int64)
    return Payloads(buffer, np.cumsum(sizes) - sizes, sizes, times)


def join(parts: Sequence[Payloads]) -> Payloads:
    """All messages of some payloads by rising log time."""
    if not parts:
        return payloads_of([], [])
    shifts = np.cumsum([0, *(len(part.buffer) for part in parts[:-1])])
    log_time = np.concatenate([part.log_time for part in parts])
    order = np.argsort(log_time, kind="stable")
    offset = np.concatenate([p.offset + s for p, s in zip(parts, shifts, strict=True)])
    return Payloads(
        buffer=np.concatenate([part.buffer for part in parts]),
        offset=offset[order],
        size=np.concatenate([part.size for part in parts])[order],
        log_time=log_time[order],
    )
