# SPDX-License-Identifier: Apache-2.0
"""CDR messages to and from columns of numbers, thousands at a time.

All messages of a topic whose strings and sequences have the same lengths have the same layout: their numbers lie at
the same offsets and are taken out, or put in, as columns of one array. Only the first message of each layout is walked
through field by field. Encoding is plain CDR (XCDR1, as ROS 2 uses it): numbers are aligned to their size, counted
from behind the four bytes of the encapsulation header.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Nodetype
from rosbags.typesys import TypesysError, get_types_from_idl, get_types_from_msg

from worm_model.bags.bag_errors import BagError
from worm_model.bags.payloads import Bytes, Integers, Payloads, Times, groups, payloads_of

HEADER_BYTES = 4
BIG, LITTLE = b"\x00\x00", b"\x00\x01"  # representation identifiers of plain CDR
LITTLE_HEADER = LITTLE + b"\x00\x00"
_CODES = {"bool": "?", "byte": "u1", "char": "u1", "octet": "u1"} | {
    f"{kind}{bits}": f"{kind[0]}{bits // 8}"
    for kind in ("int", "uint", "float")
    for bits in (8, 16, 32, 64)
}

_CONSTANT = re.compile(r"[A-Za-z]\w*\s+[A-Z]\w*\s*=")
_UNREADABLE = (TypesysError, ValueError, KeyError, IndexError, RecursionError)

Fields = list[tuple[str, Any]]
Types = Mapping[str, Fields]


def parse_types(type_name: str, definition: str, definition_format: str) -> Types:
    """Fields of a type and of all that it needs.

    Raises:
        BagError: the definition cannot be read.
    """
    try:
        if definition_format == "ros2idl":
            return _idl_fields(definition)
        try:
            return _msg_fields(type_name, without_comments(definition))
        except _UNREADABLE:
            return _msg_fields(type_name, definition)
    except _UNREADABLE as error:
        reason = " ".join(str(error).split())
        raise BagError(f"the definition of {type_name} cannot be read: {reason}") from None


@lru_cache(maxsize=256)  # the parser takes its time for every line
def _msg_fields(type_name: str, definition: str) -> Types:
    return _fields(get_types_from_msg(definition, type_name))


@lru_cache(maxsize=256)
def _idl_fields(definition: str) -> Types:
    found: dict[str, Any] = {}
    for part in definition.split("=" * 80 + "\n"):
        idl = part.split("\n", 1)[1] if part.startswith("IDL:") else part
        found.update(get_types_from_idl(idl) if idl.strip() else {})
    return _fields(found)


def _fields(found: Mapping[str, Any]) -> Types:
    return {name: list(fields) for name, (_, fields) in found.items()}


def without_comments(definition: str) -> str:
    """The lines of a definition that matter for the layout: no comments, no constants."""
    lines = (line.split("#", 1)[0].strip() for line in definition.splitlines())
    return "\n".join(line for line in lines if line and not _CONSTANT.match(line)) + "\n"


@dataclass
class _Cursor:
    """Where the walk through a message is, and what it has found. Offsets are from the first byte of the message.

    Attributes:
        numbers: (code, offset, count) by path; count None for a single number.
        texts: (offset, length) of the characters by path, without their terminator.
        words: (offset, value) of the lengths.
    """

    position: int = HEADER_BYTES
    numbers: dict[str, tuple[str, int, int | None]] = field(default_factory=dict)
    texts: dict[str, tuple[int, int]] = field(default_factory=dict)
    words: list[tuple[int, int]] = field(default_factory=list)

    def align(self, size: int) -> None:
        self.position += -(self.position - HEADER_BYTES) % size

    def advance(self, size: int) -> None:
        self.position += size

    def number(self, path: str, code: str, count: int | None) -> None:
        size = np.dtype(code).itemsize
        if count != 0:  # nothing is aligned for no elements
            self.align(size)
        self.numbers[path] = (code, self.position, count)
        self.advance(size * (1 if count is None else count))

    def word(self, path: str, empty: int) -> int:
        """Length of a string (terminator included) or sequence; `empty` is that of one that is not given."""
        self.align(4)
        value = self.length(path, empty)
        self.words.append((self.position, value))
        self.advance(4)
        return value

    def text(self, path: str) -> None:
        length = self.word(path, empty=1)
        self.texts[path] = (self.position, max(length - 1, 0))
        self.advance(length)

    def length(self, path: str, empty: int) -> int:
        """Value of a length word, `empty` where nothing is known of it."""
        raise NotImplementedError


@dataclass
class _ReadCursor(_Cursor):
    """Takes lengths from a message, and never leaves it."""

    data: bytes = b""
    order: str = "<"

    def advance(self, size: int) -> None:
        self.position += size
        if self.position > len(self.data):
            raise BagError("a message is shorter than its type says")

    def length(self, path: str, empty: int) -> int:  # noqa: ARG002 - a message says all lengths
        if self.position + 4 > len(self.data):
            raise BagError("a message is shorter than its type says")
        value: int = struct.unpack_from(f"{self.order}I", self.data, self.position)[0]
        return value


@dataclass
class _WriteCursor(_Cursor):
    """Takes lengths from what is to be written: texts, and counts of sequences."""

    lengths: Mapping[str, int] = field(default_factory=dict)

    def length(self, path: str, empty: int) -> int:
        return self.lengths.get(path, empty)


def _walk(types: Types, type_name: str, prefix: str, cursor: _Cursor) -> None:
    if type_name not in types:
        raise BagError(f"the definition of {type_name} is missing")
    if not types[type_name]:
        cursor.advance(1)  # an empty message is a byte long
    for name, description in types[type_name]:
        _walk_field(types, description, f"{prefix}{name}", cursor)


def _walk_field(types: Types, description: Any, path: str, cursor: _Cursor) -> None:
    kind, argument = description
    if kind == Nodetype.NAME:
        _walk(types, argument, f"{path}.", cursor)
    elif kind == Nodetype.BASE:
        _walk_base(argument[0], path, None, cursor)
    else:
        element, size = argument
        count = size if kind == Nodetype.ARRAY else cursor.word(path, empty=0)
        if element[0] == Nodetype.BASE and element[1][0] in _CODES:
            _walk_base(element[1][0], path, count, cursor)
        else:
            for index in range(count):
                _walk_field(types, element, f"{path}[{index}]", cursor)


def _walk_base(base: str, path: str, count: int | None, cursor: _Cursor) -> None:
    if base in _CODES:
        cursor.number(path, _CODES[base], count)
    elif base == "string":
        cursor.text(path)
    else:
        raise BagError(f"{path} is a {base}, which cannot be decoded")


@dataclass(frozen=True)
class Columns:
    """Fields of many messages, one array a field.

    Attributes:
        numbers: by path such as ``header.stamp.sec``; shape (messages,) or, for arrays, (messages, count). A field that
            some messages lack (sequences of differing lengths) is an object array with None where it is missing.
        texts: by path, one string a message; None where it is missing.
    """

    numbers: dict[str, NDArray[Any]]
    texts: dict[str, list[str | None]]


def decode(messages: Payloads, type_name: str, types: Types) -> Columns:
    """Columns of messages of one type.

    Raises:
        BagError: a message is not plain CDR, or not of that type.
    """
    columns = Columns({}, {})
    waiting = np.arange(len(messages))
    while len(waiting):
        template = messages.message(int(waiting[0]))
        cursor = _template_cursor(template, type_name, types)
        candidates = waiting[messages.size[waiting] == len(template)]
        block = messages.rows(candidates)
        same = _same_layout(block, cursor, template)
        _take(columns, cursor, block[same], candidates[same], len(messages))
        waiting = np.setdiff1d(waiting, candidates[same], assume_unique=True)
    return columns


def _template_cursor(template: bytes, type_name: str, types: Types) -> _ReadCursor:
    if template[:2] not in (BIG, LITTLE):
        raise BagError(
            f"a message of {type_name} is not plain CDR: it begins with {template[:4]!r}"
        )
    cursor = _ReadCursor(data=template, order="<" if template[:2] == LITTLE else ">")
    _walk(types, type_name, "", cursor)
    return cursor


def _same_layout(block: Bytes, cursor: _Cursor, template: bytes) -> NDArray[np.bool_]:
    """Which rows have the representation and all lengths of the template."""
    fixed = [0, 1] + [offset + i for offset, _ in cursor.words for i in range(4)]
    expected = np.frombuffer(template, np.uint8)[fixed]
    same: NDArray[np.bool_] = (block[:, fixed] == expected).all(axis=1)
    return same


def _take(
    columns: Columns,
    cursor: _ReadCursor,
    block: Bytes,
    rows: NDArray[np.int64],
    total: int,
) -> None:
    for path, (code, offset, count) in cursor.numbers.items():
        dtype = np.dtype(code)
        size = dtype.itemsize * (1 if count is None else count)
        raw = np.ascontiguousarray(block[:, offset : offset + size])
        stored = dtype.newbyteorder("<" if cursor.order == "<" else ">")
        values = raw.view(stored).astype(dtype)
        if count is None:
            values = values.reshape(len(rows))
        _place(columns.numbers, path, values, rows, total)
    for path, (offset, length) in cursor.texts.items():
        texts = columns.texts.setdefault(path, [None] * total)
        for row, text in zip(rows, _texts(block[:, offset : offset + length]), strict=True):
            texts[row] = text


def _texts(characters: Bytes) -> list[str]:
    """A text a row; most often all are the same."""
    if (characters == characters[0]).all():
        return [characters[0].tobytes().decode(errors="replace")] * len(characters)
    return [row.tobytes().decode(errors="replace") for row in characters]


def _place(
    found: dict[str, NDArray[Any]],
    path: str,
    values: NDArray[Any],
    rows: NDArray[np.int64],
    total: int,
) -> None:
    """Put the values of some rows into a column, which has a plain shape as long as all rows agree on it."""
    if len(rows) == total:
        found[path] = values
        return
    if path not in found:
        found[path] = np.full(total, None, dtype=object)
    column = found[path]
    for row, value in zip(rows, values, strict=True):
        column[row] = value
    if all(value is not None for value in column) and len({np.shape(v) for v in column}) == 1:
        found[path] = np.array(list(column), dtype=values.dtype)


def encode(
    log_time: Integers | Times,
    type_name: str,
    types: Types,
    numbers: Mapping[str, NDArray[Any] | float],
    texts: Mapping[str, str | Sequence[str]],
) -> Payloads:
    """Messages of one type from columns; what is not given is zero or empty.

    Args:
        log_time: of each message, ns since the epoch, shape (count,).
        numbers: by path; one value for all messages, shape (count,), or (count, k) for a sequence of k numbers.
        texts: by path; one text for all messages, or one a message. A sequence of texts is given by its elements'
            paths, ``name[0]`` and so on.

    Raises:
        BagError: the type has no such field.
    """
    count = len(log_time)
    constant, varying = {}, {}
    for path, text in texts.items():
        if isinstance(text, str):
            constant[path] = np.frombuffer(text.encode(), np.uint8).reshape(1, -1)
        else:
            varying[path] = payloads_of(list(map(str.encode, text)), log_time)
    blocks: list[Bytes] = []
    offset, size = np.empty(count, np.int64), np.empty(count, np.int64)
    filled = 0
    for rows in _alike(count, [text.size for text in varying.values()]):
        part = {p: v[rows] if isinstance(v, np.ndarray) else v for p, v in numbers.items()}
        characters = constant | {path: text.rows(rows) for path, text in varying.items()}
        block = _encode_alike(len(rows), type_name, types, part, characters)
        size[rows] = block.shape[1]
        offset[rows] = filled + block.shape[1] * np.arange(len(rows))
        filled += block.size
        blocks.append(block.reshape(-1))
    buffer = np.concatenate([np.empty(0, np.uint8), *blocks])
    return Payloads(buffer, offset, size, log_time.astype(np.uint64))


def _alike(count: int, lengths: Iterable[Integers]) -> Iterator[Integers]:
    """Rows whose texts have the same lengths, hence one layout; the lengths of a text are of shape (count,)."""
    layout = np.zeros(count, np.int64)
    for length in lengths:
        layout = np.unique(layout, return_inverse=True)[1]  # small numbers, for the product
        layout = layout * (length.max(initial=0) + 1) + length
    for _, rows in groups(layout):
        yield rows


def _encode_alike(
    count: int,
    type_name: str,
    types: Types,
    numbers: Mapping[str, NDArray[Any] | float],
    texts: Mapping[str, Bytes],
) -> Bytes:
    """Messages of one layout, shape (count, bytes of each), from texts of shape (1 or count, length)."""
    cursor = _WriteCursor(lengths=_lengths(numbers, texts))
    _walk(types, type_name, "", cursor)
    unknown = (numbers.keys() - cursor.numbers.keys()) | (texts.keys() - cursor.texts.keys())
    if unknown:
        raise BagError(f"{type_name} has no field {sorted(unknown)[0]}")
    block = np.zeros((count, cursor.position), np.uint8)
    block[:, :HEADER_BYTES] = np.frombuffer(LITTLE_HEADER, np.uint8)
    for offset, value in cursor.words:
        _column(block, "u4", offset, None)[...] = value
    for path, text in texts.items():
        offset, length = cursor.texts[path]
        block[:, offset : offset + length] = text
    for path, values in numbers.items():
        _column(block, *cursor.numbers[path])[...] = np.asarray(values)
    return block


def _column(block: Bytes, code: str, offset: int, elements: int | None) -> NDArray[Any]:
    """A number of each message, shape (count,), or several, shape (count, elements): to be filled in."""
    dtype = np.dtype(code).newbyteorder("<")
    shape = (len(block),) if elements is None else (len(block), elements)
    strides = (block.shape[1], dtype.itemsize)[: len(shape)]
    return np.ndarray(shape, dtype, block, offset, strides)


def _lengths(
    numbers: Mapping[str, NDArray[Any] | float], texts: Mapping[str, Bytes]
) -> dict[str, int]:
    """Length words of texts (with their terminator) and of sequences (by their columns or elements)."""
    lengths = {path: text.shape[1] + 1 for path, text in texts.items()}
    for path, values in numbers.items():
        if np.ndim(values) == 2:
            lengths[path] = np.shape(values)[1]
    for path in texts:
        if path.endswith("]"):
            sequence = path.rpartition("[")[0]
            lengths[sequence] = lengths.get(sequence, 0) + 1
    return lengths
