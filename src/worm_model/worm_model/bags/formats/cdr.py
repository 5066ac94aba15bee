# SPDX-License-Identifier: Apache-2.0
"""Conversion of CDR messages to columns of numbers, thousands of messages at a time, and of columns to messages.

All messages of a topic whose strings and sequences have the same lengths have the same layout. Their numbers have the
same offsets and become columns of one array. Only the first message of each layout is decoded field by field. The
deserialisers of `rosbags` create an object for every message, which takes 4 µs. This is ten times too long for a
replay at a thousand times real time. Encoding uses `rosbags`. The format is plain CDR (XCDR1, as in ROS 2): numbers
are aligned to their size, counted from the end of the encapsulation header of four bytes.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Nodetype
from rosbags.serde import SerdeError

from worm_model.bags.formats.bag_errors import BagError
from worm_model.bags.formats.message_block import Bytes, Integers, Messages, Times, Topic
from worm_model.bags.formats.message_types import (
    REMEDY,
    Types,
    parse_types,
    typestore,
    with_definition,
)

HEADER_BYTES = 4
PADDING_BYTES = 3  # largest number of bytes that a middleware appends to a message
BIG, LITTLE = b"\x00\x00", b"\x00\x01"  # representation identifiers of plain CDR
_CODES = {"bool": "?", "byte": "u1", "char": "u1", "octet": "u1"} | {
    f"{kind}{bits}": f"{kind[0]}{bits // 8}"
    for kind in ("int", "uint", "float")
    for bits in (8, 16, 32, 64)
}


# --- decoding -------------------------------------------------------------------------------------


@dataclass(frozen=True)
class MessageColumns:
    """All fields of messages by path, such as ``header.stamp.sec`` or ``status[0].message``.

    Attributes:
        numbers: shape (messages,), or (messages, elements) for an array. If some messages lack the field or differ in
            the length of an array, the dtype is object: None, a Python number, or an array for each message.
        texts: one text per message, None if the message lacks the field.
        log_time: times of reception, ns since the epoch.
    """

    numbers: dict[str, NDArray[Any]] = field(default_factory=dict)
    texts: dict[str, list[str | None]] = field(default_factory=dict)
    log_time: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, np.int64))


class ColumnBuilder:
    """Builder of columns from several blocks of messages, whose layouts and definitions may differ.

    Args:
        longest: largest number of elements of an array; longer arrays are omitted. None: any number.

    Attributes:
        omitted: paths of the omitted arrays.
    """

    def __init__(self, longest: int | None = None) -> None:
        self.omitted: set[str] = set()
        self._longest = longest
        self._count = 0
        self._log_times: list[Times] = []
        self._numbers: dict[str, list[tuple[Integers, NDArray[Any]]]] = {}
        self._texts: dict[str, list[tuple[Integers, list[str]]]] = {}

    def add(self, messages: Messages) -> None:
        """Append messages, each decoded with the definition of its own channel."""
        for index in np.unique(messages.channel).tolist():
            topic, rows = messages.channels[index], np.flatnonzero(messages.channel == index)
            try:
                self._add_channel(messages, rows, topic)
            except BagError as error:
                hint = (
                    ""
                    if topic.definition or not topic.type_name
                    else f"; the bag contains no definition: {REMEDY}"
                )
                raise BagError(f"{topic.name}: {error}{hint}") from None
        self._count += len(messages)
        self._log_times.append(messages.log_time)

    def _add_channel(self, messages: Messages, waiting: Integers, topic: Topic) -> None:
        types = types_of(topic)
        while len(waiting):
            candidates = waiting[messages.size[waiting] == messages.size[waiting[0]]]
            data = messages.payloads(candidates)
            layout = _Layout(data[0].tobytes(), topic.type_name, types)
            same = layout.fits(data)
            rows = candidates[same] + self._count
            for path, values in layout.numbers(data[same]):
                if self._longest is not None and values[0].size > self._longest:
                    self.omitted.add(path)
                else:
                    self._numbers.setdefault(path, []).append((rows, values))
            for path, texts in layout.texts(data[same]):
                self._texts.setdefault(path, []).append((rows, texts))
            waiting = np.setdiff1d(waiting, candidates[same], assume_unique=True)

    def columns(self) -> MessageColumns:
        """Return the columns of all messages added so far."""
        numbers = {
            path: _joined(parts, self._count)
            for path, parts in self._numbers.items()
            if path not in self.omitted
        }
        texts: dict[str, list[str | None]] = {}
        for path, parts in self._texts.items():
            column = texts.setdefault(path, [None] * self._count)
            for rows, values in parts:
                for row, value in zip(rows.tolist(), values, strict=True):
                    column[row] = value
        log_time = np.concatenate([np.empty(0, np.uint64), *self._log_times])
        return MessageColumns(numbers, texts, log_time.astype(np.int64))


def decode(messages: Messages) -> MessageColumns:
    """Return the columns of a block of messages. Raises BagError as `ColumnBuilder.add`."""
    builder = ColumnBuilder()
    builder.add(messages)
    return builder.columns()


def types_of(topic: Topic) -> Types:
    """Return the fields of a topic's type, from the definition inside the bag or else the installed one."""
    if topic.encoding != "cdr":
        raise BagError(f"it is encoded as {topic.encoding!r}; only cdr can be decoded")
    topic = with_definition(topic)
    return parse_types(topic.type_name, topic.definition, topic.definition_format)


def _joined(parts: list[tuple[Integers, NDArray[Any]]], total: int) -> NDArray[Any]:
    """Return a column: plain numbers if all messages have the field with the same shape, else objects."""
    shapes = {values.shape[1:] for _, values in parts}
    if len(shapes) == 1 and sum(len(rows) for rows, _ in parts) == total:
        kind = np.result_type(*(values for _, values in parts))
        column = np.empty((total, *shapes.pop()), kind)
        for rows, values in parts:
            column[rows] = values
        return column
    column = np.full(total, None, dtype=object)
    for rows, values in parts:
        items = values.tolist() if values.ndim == 1 else values
        for row, value in zip(rows.tolist(), items, strict=True):
            column[row] = value
    return column


class _Layout:
    """Offsets of the fields of a message, found by decoding it."""

    def __init__(self, message: bytes, type_name: str, types: Types) -> None:
        if message[:2] not in (BIG, LITTLE):
            raise BagError(
                f"a message is not plain CDR: it begins with {message[:4]!r}; if rosbag2 has compressed it, convert "
                "the bag: ros2 bag convert"
            )
        self._message = message
        self._types = types
        self._order = "<" if message[:2] == LITTLE else ">"
        self._position = HEADER_BYTES
        self._numbers: dict[str, tuple[np.dtype[Any], int, int | None]] = {}
        self._texts: dict[str, tuple[int, int]] = {}
        self._length_offsets: list[int] = []
        try:
            self._walk(type_name, "")
        except RecursionError:
            raise BagError(
                "its definition contains itself, or a message is nested too deeply"
            ) from None
        surplus = len(message) - self._position
        if surplus > PADDING_BYTES:
            raise BagError(f"a message is {surplus} bytes longer than its definition requires")

    def fits(self, data: Bytes) -> NDArray[np.bool_]:
        """Return a mask (messages,) of the messages that have this layout.

        ``data`` (messages, bytes) contains one message per row. All messages are as long as the one that was decoded.
        """
        fixed = [0, 1] + [offset + i for offset in self._length_offsets for i in range(4)]
        expected = np.frombuffer(self._message, np.uint8)[fixed]
        same: NDArray[np.bool_] = (data[:, fixed] == expected).all(axis=1)
        return same

    def numbers(self, data: Bytes) -> Iterator[tuple[str, NDArray[Any]]]:
        """Yield (path, values) of each field of numbers, from messages (messages, bytes) of this layout."""
        for path, (kind, offset, count) in self._numbers.items():
            size = kind.itemsize * (1 if count is None else count)
            raw = np.ascontiguousarray(data[:, offset : offset + size])
            values = raw.view(kind) if size else np.empty((len(data), 0), kind)
            values = values.astype(kind.newbyteorder("="))
            yield path, values.reshape(len(data)) if count is None else values

    def texts(self, data: Bytes) -> Iterator[tuple[str, list[str]]]:
        """Yield (path, texts) of each field of text, from messages (messages, bytes) of this layout.

        Usually all messages have the same text, which is then decoded only once.
        """
        for path, (offset, length) in self._texts.items():
            characters = data[:, offset : offset + length]
            if (characters == characters[0]).all():
                yield path, [characters[0].tobytes().decode(errors="replace")] * len(data)
            else:
                yield path, [row.tobytes().decode(errors="replace") for row in characters]

    def _advance(self, size: int, alignment: int) -> int:
        """Return the aligned position of a field of ``size`` bytes, and move the present position behind the field."""
        self._position += -(self._position - HEADER_BYTES) % alignment
        position = self._position
        self._position += size
        if self._position > len(self._message):
            raise BagError("a message is shorter than its definition requires")
        return position

    def _read_length(self) -> int:
        """Return the length of a string (with its terminator) or of a sequence, read at the present position."""
        offset = self._advance(4, 4)
        self._length_offsets.append(offset)
        length: int = struct.unpack_from(f"{self._order}I", self._message, offset)[0]
        return length

    def _walk(self, type_name: str, prefix: str) -> None:
        if not self._types[type_name]:
            self._advance(1, 1)  # an empty message is one byte long
        for name, description in self._types[type_name]:
            self._walk_field(description, f"{prefix}{name}")

    def _walk_field(self, description: Any, path: str) -> None:
        kind, argument = description
        if kind == Nodetype.NAME:
            self._walk(argument, f"{path}.")
        elif kind == Nodetype.BASE:
            self._walk_base(argument[0], path, None)
        else:
            element, size = argument
            count = size if kind == Nodetype.ARRAY else self._read_length()
            if element[0] == Nodetype.BASE and element[1][0] in _CODES:
                self._walk_base(element[1][0], path, count)
            else:
                for index in range(count):
                    self._walk_field(element, f"{path}[{index}]")

    def _walk_base(self, base: str, path: str, count: int | None) -> None:
        if base == "string":
            length = self._read_length()
            self._texts[path] = self._advance(length, 1), max(length - 1, 0)
        elif base in _CODES:
            kind = np.dtype(f"{self._order}{_CODES[base]}")
            elements = 1 if count is None else count
            offset = self._advance(kind.itemsize * elements, kind.itemsize if elements else 1)
            self._numbers[path] = kind, offset, count
        else:
            raise BagError(f"{path} is of type {base}, which cannot be decoded")


# --- encoding -------------------------------------------------------------------------------------


def encode(
    topic: Topic, count: int, numbers: Mapping[str, Any], texts: Mapping[str, Any]
) -> list[bytes]:
    """Return messages of a topic from columns; all other fields are zero or empty.

    Args:
        topic: topic with its definition.
        count: number of messages.
        numbers: values by path: a scalar for all messages, shape (count,), or (count, k) for an array of k numbers.
            Fields of integers require integers.
        texts: texts by path: one text for all messages, or one text per message.
    """
    from rosbags.convert.converter import default_message  # here: it loads slowly

    store = typestore(topic.type_name, topic.definition, topic.definition_format)
    message: Any = default_message(store, topic.type_name)
    setters: list[tuple[Callable[[Any], None], Sequence[Any]]] = []
    for path, value in [*numbers.items(), *texts.items()]:
        setter = _setter(message, path)
        if isinstance(value, str) or np.ndim(value) == 0:
            setter(value.item() if isinstance(value, np.generic) else value)
        else:
            plain = isinstance(value, np.ndarray) and value.ndim == 1
            setters.append((setter, value.tolist() if plain else value))
    messages = []
    for row in range(count):
        for setter, values in setters:
            setter(values[row])
        messages.append(bytes(store.serialize_cdr(message, topic.type_name)))
    return messages


def _setter(message: Any, path: str) -> Callable[[Any], None]:
    """Return a function that sets a field of a message."""
    *parents, name = path.split(".")
    for parent in parents:
        message = getattr(message, parent, None)
    if not hasattr(message, name):
        raise BagError(f"there is no field {path}")
    before = getattr(message, name)
    if isinstance(before, np.ndarray):
        return lambda value: setattr(message, name, np.asarray(value, before.dtype))
    return lambda value: setattr(message, name, value)


def is_whole(topic: Topic, data: bytes) -> bool:
    """Return True if a message is as long as the definition of its topic requires."""
    try:
        typestore(topic.type_name, topic.definition, topic.definition_format).deserialize_cdr(
            data, topic.type_name
        )
    except SerdeError:
        return False
    return True
