# SPDX-License-Identifier: Apache-2.0
"""CDR messages to columns of numbers, thousands at a time, and columns to messages.

All messages of a topic whose strings and sequences have the same lengths have the same layout: their numbers lie at
the same offsets and are taken out as columns of one array. Only the first message of each layout is walked through
field by field; the deserialisers of `rosbags`, which make an object of every message, take 4 µs for each, ten times
too long for a replay of a thousand times real time. Encoding is theirs. The format is plain CDR (XCDR1, as ROS 2 uses
it): numbers are aligned to their size, counted from behind the four bytes of the encapsulation header.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.convert.converter import default_message, migrate_message
from rosbags.interfaces import Nodetype
from rosbags.serde import SerdeError

from worm_model.bags.bag_errors import BagError, DefinitionError
from worm_model.bags.message_block import Bytes, Integers, Message, Messages, Topic
from worm_model.bags.message_types import REMEDY, Types, parse_types, typestore, with_definition

HEADER_BYTES = 4
PADDING_BYTES = 3  # that a middleware may append to a message
BIG, LITTLE = b"\x00\x00", b"\x00\x01"  # representation identifiers of plain CDR
_CODES = {"bool": "?", "byte": "u1", "char": "u1", "octet": "u1"} | {
    f"{kind}{bits}": f"{kind[0]}{bits // 8}"
    for kind in ("int", "uint", "float")
    for bits in (8, 16, 32, 64)
}


# --- decoding -------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Columns:
    """All fields of messages by path, such as ``header.stamp.sec`` or ``status[0].message``.

    Attributes:
        numbers: shape (messages,), or (messages, elements) for an array. Where messages lack the field, or differ in
            the length of an array, an array of objects: None, a Python number, or an array.
        texts: one a message, None where a message lacks the field.
    """

    numbers: dict[str, NDArray[Any]] = field(default_factory=dict)
    texts: dict[str, list[str | None]] = field(default_factory=dict)


class ColumnBuilder:
    """Puts messages together that come part by part, in layouts and by definitions that may differ."""

    def __init__(self) -> None:
        self.count = 0
        self._numbers: dict[str, list[tuple[Integers, NDArray[Any]]]] = {}
        self._texts: dict[str, list[tuple[Integers, list[str]]]] = {}

    def add(self, messages: Messages) -> None:
        """Append messages, each read by the definition of its own channel.

        Raises:
            BagError: one cannot be decoded, or is longer or shorter than its definition says.
        """
        for index in np.unique(messages.channel).tolist():
            topic, rows = messages.channels[index], np.flatnonzero(messages.channel == index)
            try:
                self._add_channel(messages, rows, topic)
            except BagError as error:
                hint = (
                    ""
                    if topic.definition or not topic.type_name
                    else f"; the bag carries none of it: {REMEDY}"
                )
                raise BagError(f"{topic.name}: {error}{hint}") from None
        self.count += len(messages)

    def _add_channel(self, messages: Messages, waiting: Integers, topic: Topic) -> None:
        types = types_of(topic)
        while len(waiting):
            first = int(waiting[0])
            layout = _Layout(messages.payload(first), topic.type_name, types)
            candidates = waiting[messages.size[waiting] == messages.size[first]]
            data = messages.payloads(candidates)
            same = layout.fits(data)
            rows = candidates[same] + self.count
            for path, values in layout.numbers(data[same]):
                self._numbers.setdefault(path, []).append((rows, values))
            for path, texts in layout.texts(data[same]):
                self._texts.setdefault(path, []).append((rows, texts))
            waiting = np.setdiff1d(waiting, candidates[same], assume_unique=True)

    def columns(self) -> Columns:
        """All that was added."""
        numbers = {path: _joined(parts, self.count) for path, parts in self._numbers.items()}
        texts: dict[str, list[str | None]] = {}
        for path, parts in self._texts.items():
            column = texts.setdefault(path, [None] * self.count)
            for rows, values in parts:
                for row, value in zip(rows.tolist(), values, strict=True):
                    column[row] = value
        return Columns(numbers, texts)


def types_of(topic: Topic) -> Types:
    """Fields of a topic's type, by the definition inside the bag, or by the installed one if it has none.

    Raises:
        BagError: it is not CDR, or its definition is missing or cannot be read.
    """
    if topic.encoding != "cdr":
        raise BagError(f"it is encoded as {topic.encoding!r}; only cdr can be decoded")
    topic = with_definition(topic)
    return parse_types(topic.type_name, topic.definition, topic.definition_format)


def _joined(parts: list[tuple[Integers, NDArray[Any]]], total: int) -> NDArray[Any]:
    """A column of plain numbers where all messages agree in its shape, of objects elsewhere."""
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
    """Where the fields of a message lie, by walking through it."""

    def __init__(self, message: bytes, type_name: str, types: Types) -> None:
        if message[:2] not in (BIG, LITTLE):
            raise BagError(f"a message is not plain CDR: it begins with {message[:4]!r}")
        self._message = message
        self._types = types
        self._order = "<" if message[:2] == LITTLE else ">"
        self._position = HEADER_BYTES
        self._numbers: dict[str, tuple[np.dtype[Any], int, int | None]] = {}
        self._texts: dict[str, tuple[int, int]] = {}
        self._words: list[int] = []  # offsets of lengths
        try:
            self._walk(type_name, "")
        except RecursionError:
            raise BagError(
                "its definition contains itself, or a message is nested too deeply"
            ) from None
        surplus = len(message) - self._position
        if surplus > PADDING_BYTES:
            raise BagError(f"a message is {surplus} bytes longer than its definition says")

    def fits(self, data: Bytes) -> NDArray[np.bool_]:
        """Which of some messages of the same size, a row each, have the same representation and lengths."""
        fixed = [0, 1] + [offset + i for offset in self._words for i in range(4)]
        expected = np.frombuffer(self._message, np.uint8)[fixed]
        same: NDArray[np.bool_] = (data[:, fixed] == expected).all(axis=1)
        return same

    def numbers(self, data: Bytes) -> Iterator[tuple[str, NDArray[Any]]]:
        """Columns of messages of this layout."""
        for path, (kind, offset, count) in self._numbers.items():
            size = kind.itemsize * (1 if count is None else count)
            raw = np.ascontiguousarray(data[:, offset : offset + size])
            values = raw.view(kind) if size else np.empty((len(data), 0), kind)
            values = values.astype(kind.newbyteorder("="))
            yield path, values.reshape(len(data)) if count is None else values

    def texts(self, data: Bytes) -> Iterator[tuple[str, list[str]]]:
        """Texts of messages of this layout; most often all are the same."""
        for path, (offset, length) in self._texts.items():
            characters = data[:, offset : offset + length]
            if (characters == characters[0]).all():
                yield path, [characters[0].tobytes().decode(errors="replace")] * len(data)
            else:
                yield path, [row.tobytes().decode(errors="replace") for row in characters]

    def _advance(self, size: int, alignment: int) -> int:
        """Position of something of a size, behind which the walk goes on."""
        self._position += -(self._position - HEADER_BYTES) % alignment
        position = self._position
        self._position += size
        if self._position > len(self._message):
            raise BagError("a message is shorter than its definition says")
        return position

    def _word(self) -> int:
        """Length of a string (terminator included) or sequence."""
        offset = self._advance(4, 4)
        self._words.append(offset)
        length: int = struct.unpack_from(f"{self._order}I", self._message, offset)[0]
        return length

    def _walk(self, type_name: str, prefix: str) -> None:
        if not self._types[type_name]:
            self._advance(1, 1)  # an empty message is a byte long
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
            count = size if kind == Nodetype.ARRAY else self._word()
            if element[0] == Nodetype.BASE and element[1][0] in _CODES:
                self._walk_base(element[1][0], path, count)
            else:
                for index in range(count):
                    self._walk_field(element, f"{path}[{index}]")

    def _walk_base(self, base: str, path: str, count: int | None) -> None:
        if base == "string":
            length = self._word()
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
    """Messages of a topic from columns; what is not given is zero or empty.

    Args:
        topic: with its definition.
        count: number of messages.
        numbers: by path; one value for all messages, shape (count,), or (count, k) for an array of k numbers; whole
            ones for a field of integers.
        texts: by path; one text for all messages, or one a message.

    Raises:
        BagError: the type has no such field.
    """
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
    """Sets a field of a message."""
    *parents, name = path.split(".")
    for parent in parents:
        message = getattr(message, parent, None)
    if not hasattr(message, name):
        raise BagError(f"there is no field {path}")
    before = getattr(message, name)
    if isinstance(before, np.ndarray):
        return lambda value: setattr(message, name, np.asarray(value, before.dtype))
    return lambda value: setattr(message, name, value)


def check_length(topic: Topic, data: bytes) -> None:
    """Compare a message with a definition that did not come with it.

    Raises:
        BagError: it is longer or shorter than that says.
    """
    store = typestore(topic.type_name, topic.definition, topic.definition_format)
    try:
        store.deserialize_cdr(data, topic.type_name)
    except SerdeError:
        raise BagError(
            f"{topic.name} carries no definition, and a message of it is not as long as the {topic.type_name} "
            f"that is taken for it says; {REMEDY}"
        ) from None


def defined_message(message: Message) -> Message:
    """A message with a definition: its own, or the installed one, which must fit.

    Raises:
        BagError: it is longer or shorter than the installed definition says, or that is missing or another by its
            hash.
    """
    if message.channel.definition:
        return message
    channel = with_definition(message.channel)
    check_length(channel, message.data)
    return message._replace(channel=channel)


class Converter:
    """Messages of a definition as those of another one that has further fields, which are zero or empty.

    Args:
        source, target: topics with their definitions.

    Raises:
        DefinitionError: the target lacks a field of the source, or has it with another type.

    Attributes:
        added: the fields that only the target has.
    """

    def __init__(self, source: Topic, target: Topic) -> None:
        one, other = types_of(source), types_of(target)
        self.added: list[str] = []
        for name in one.keys() & other.keys():
            before, after = dict(one[name]), dict(other[name])
            changed = [field for field in before if before[field] != after.get(field)]
            if changed:
                raise DefinitionError(
                    f"{changed[0]} of {name} is not what the installed definition says"
                )
            self.added += [field for field in after if field not in before]
        same_order = all(
            [f for f, _ in other[n] if f in dict(one[n])] == [f for f, _ in one[n]]
            for n in one.keys() & other.keys()
        )
        if source.type_name not in other:
            raise DefinitionError(f"it is not a {target.type_name}")
        self.same = not self.added and same_order
        self._source, self._target = source, target
        self._defaults: dict[str, object] = {}
        self._stores = [
            typestore(t.type_name, t.definition, t.definition_format) for t in (source, target)
        ]

    def __call__(self, data: bytes) -> bytes:
        """A message in the target's layout.

        Raises:
            BagError: it is longer or shorter than the source's definition says.
        """
        old, new = self._stores
        try:
            content = old.deserialize_cdr(data, self._source.type_name)
        except SerdeError:
            raise BagError("a message is not as long as its definition says") from None
        if self.same:
            return data
        kinds = self._source.type_name, self._target.type_name
        message = migrate_message(old, new, *kinds, self._defaults, content)
        return bytes(new.serialize_cdr(message, self._target.type_name))
