# SPDX-License-Identifier: Apache-2.0
"""Many messages of one topic in one array of bytes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Bytes = NDArray[np.uint8]
Integers = NDArray[np.int64]
Times = NDArray[np.uint64]  # ns since the epoch, unsigned as files have them


@dataclass(frozen=True)
class Payloads:
    """Messages, each a stretch of a buffer.

    Attributes:
        buffer: shape (bytes,), contiguous.
        offset: first byte of each message, shape (messages,).
        size: bytes of each, shape (messages,).
        log_time: when each was received, ns since the epoch, shape (messages,).
    """

    buffer: Bytes
    offset: Integers
    size: Integers
    log_time: Times

    def __len__(self) -> int:
        return len(self.offset)

    def message(self, row: int) -> bytes:
        """One of the messages."""
        start = self.offset[row]
        return self.buffer[start : start + self.size[row]].tobytes()

    def messages(self) -> list[bytes]:
        """All messages apart."""
        data = self.buffer.data
        places = zip(self.offset.tolist(), self.size.tolist(), strict=True)
        return [bytes(data[start : start + size]) for start, size in places]

    def rows(self, chosen: Integers) -> Bytes:
        """Some messages of one size, shape (len(chosen), size)."""
        size = int(self.size[chosen[0]])
        if not size:
            return np.empty((len(chosen), 0), np.uint8)
        return cells(self.buffer, size)[self.offset[chosen]].view(np.uint8).reshape(-1, size)

    def select(self, chosen: Integers | slice) -> Payloads:
        """Some of the messages, in the same buffer."""
        return Payloads(self.buffer, self.offset[chosen], self.size[chosen], self.log_time[chosen])

    def compact(self) -> Payloads:
        """The same messages in a buffer that holds nothing else, one behind the other."""
        ends = np.cumsum(self.size)
        starts = ends - self.size
        buffer = np.empty(int(ends[-1]) if len(ends) else 0, np.uint8)
        place(self, buffer, starts)
        return Payloads(buffer, starts, self.size, self.log_time)


def cells(buffer: Bytes, size: int) -> NDArray[np.void]:
    """All stretches of a size in a contiguous buffer: the i-th begins at byte i. They share its memory.

    Many of them are taken out or put in at the cost of a copy each, where an index per byte would cost tenfold.
    """
    return np.ndarray(max(len(buffer) - size + 1, 0), f"V{size}", buffer, strides=(1,))


def groups(keys: NDArray[np.integer]) -> Iterator[tuple[int, Integers]]:
    """Each value of some keys, which are not negative, with the rows that have it, in their order; by rising value."""
    if not len(keys):
        return
    narrow = keys.astype(
        np.min_scalar_type(int(keys.max()))
    )  # numpy sorts narrow integers by digits
    order = np.argsort(narrow, kind="stable")
    borders = np.flatnonzero(np.diff(narrow[order])) + 1
    for rows in np.split(order, borders):
        yield int(keys[rows[0]]), rows


def place(payloads: Payloads, target: Bytes, start: Integers) -> None:
    """Copy messages into a buffer, each to begin at its start, shape (messages,)."""
    for size, rows in groups(payloads.size):
        if size:
            source = cells(payloads.buffer, size)
            cells(target, size)[start[rows]] = source[payloads.offset[rows]]


def payloads_of(messages: Sequence[bytes], log_times: Sequence[int] | Integers | Times) -> Payloads:
    """Payloads of separate messages."""
    sizes = np.fromiter(map(len, messages), np.int64, len(messages))
    buffer = np.frombuffer(b"".join(messages), np.uint8)
    times = np.array(log_times, dtype=np.uint64)
    return Payloads(buffer, np.cumsum(sizes) - sizes, sizes, times)


def join(parts: Sequence[Payloads]) -> Payloads:
    """All messages of some payloads by rising log time, of equal ones in the order of the parts."""
    return concatenate(parts).select(time_order(parts))


def concatenate(parts: Sequence[Payloads]) -> Payloads:
    """All messages of some payloads, one after the other; copies their buffers as they are."""
    if not parts:
        return payloads_of([], [])
    if len(parts) == 1:
        return parts[0]
    shifts = np.cumsum([0, *(len(part.buffer) for part in parts[:-1])])
    return Payloads(
        buffer=np.concatenate([part.buffer for part in parts]),
        offset=np.concatenate([p.offset + s for p, s in zip(parts, shifts, strict=True)]),
        size=np.concatenate([part.size for part in parts]),
        log_time=np.concatenate([part.log_time for part in parts]),
    )


def time_order(parts: Sequence[Payloads]) -> Integers:
    """Rows of some payloads, counted through, by rising log time; of equal ones in the order of the parts."""
    times = [part.log_time for part in parts]
    return np.argsort(np.concatenate([np.empty(0, np.uint64), *times]), kind="stable")


def arrange(parts: Sequence[Payloads], order: Integers) -> Payloads:
    """All messages of some payloads in an order, given by rows counted through, in a buffer that holds nothing else."""
    log_time = np.concatenate([part.log_time for part in parts])
    size = np.concatenate([part.size for part in parts])
    start = np.empty_like(size)
    start[order] = np.cumsum(size[order]) - size[order]
    buffer = np.empty(int(size.sum()), np.uint8)
    first = 0
    for part in parts:
        place(part, buffer, start[first : first + len(part)])
        first += len(part)
    return Payloads(buffer, start[order], size[order], log_time[order])
