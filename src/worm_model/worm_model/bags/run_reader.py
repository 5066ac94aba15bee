# SPDX-License-Identifier: Apache-2.0
"""Conversion of the worm's topics in a bag to arrays."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import fields
from functools import partial
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

from worm_model.bags.formats.bag_errors import BagError, NoRunError
from worm_model.bags.formats.cdr import ColumnBuilder, MessageColumns, decode
from worm_model.bags.formats.message_block import Topic
from worm_model.bags.opening import Bag
from worm_model.bags.worm_topics import SERIES, TWIN_INPUTS, TYPES, find_topic, path_of
from worm_model.run import GaitStates, Run, concatenated
from worm_msgs.gait import GAIT_DEFAULTS

RUN_TOPICS = tuple(SERIES)
# all except gait_state, whose last message may be much older than the recording
_INSTRUMENTS = TWIN_INPUTS[1:]
# largest normal delay from the stamp of a message to its reception by the recorder
_LONGEST_DELAY_NS = 10**9


def read_run(bag: Bag, namespace: str = "", names: Sequence[str] = RUN_TOPICS) -> Run:
    """Return the worm's samples in a bag; for arguments and errors see `read_parts`."""
    parts = read_parts(bag, namespace, names)
    series = {}
    for attribute, kind in SERIES.values():
        try:
            series[attribute] = concatenated(kind, [getattr(part, attribute) for part in parts])
        except ValueError:
            raise BagError(
                f"{bag.path}: the joints of joint_states change within the bag"
            ) from None
    return Run(origin=min((part.origin for part in parts if part.origin), default=0), **series)


def read_parts(bag: Bag, namespace: str, names: Sequence[str]) -> list[Run]:
    """Return the worm's samples in the order of reception, in parts, each from about a megabyte of the bag.

    Messages with an infinite number are excluded. They are reported, and so are stamps that go back.

    Args:
        bag: an open bag.
        namespace: namespace of the robot; empty: the only one in the bag.
        names: topics to read, from RUN_TOPICS.
    """
    topic_of = {name: find_topic(bag.channels, name, namespace) for name in names}
    topics = {name: topic for name, topic in topic_of.items() if topic is not None}
    if not topics:
        raise _none_of_the_worms(bag, f" under {namespace}" if namespace else "")
    _report_unexpected_topics(bag, topic_of, namespace)
    infinite: Counter[str] = Counter()
    parts = []
    for columns in _decoded(bag, topics):
        series, stamps = {}, []
        for name, (attribute, kind) in SERIES.items():
            found, excluded = _finite(columns.get(name, MessageColumns()))
            infinite[name] += excluded
            with _located(bag, topics.get(name)):
                series[attribute] = _series(kind, found)
            stamps.append(series[attribute].stamp)
        origin = min((int(stamp.min()) for stamp in stamps if len(stamp)), default=0)
        parts.append(Run(origin=origin, **series))
    for name, topic in topics.items():
        stamp = np.concatenate([getattr(part, SERIES[name][0]).stamp for part in parts or [Run()]])
        backwards = np.count_nonzero(np.diff(stamp) < 0)
        if infinite[name]:
            bag.notify(
                f"{bag.path}: {infinite[name]} messages of {topic.name} contain an infinite number and are excluded"
            )
        if backwards:
            bag.notify(
                f"{bag.path}: {backwards} stamps of {topic.name} go back: merged runs, several publishers, or a clock "
                "that was set"
            )
    if concatenated(GaitStates, [part.gait_state for part in parts]).mixed:
        raise BagError(
            f"{bag.path}: runs of gaits overlap; recordings were merged, or two drivers published together: "
            "give the recordings one by one, or name the robot with --namespace"
        )
    return parts


def _decoded(bag: Bag, topics: Mapping[str, Topic]) -> Iterator[dict[str, MessageColumns]]:
    """Yield the columns of each block by key of ``topics``; messages of another type or encoding are left out."""
    keys = {topic.name: key for key, topic in topics.items()}
    for block in bag.blocks(keys):
        yield {
            keys[name]: decode(messages.like(topics[keys[name]]))
            for name, messages in block.by_topic()
        }


@contextmanager
def _located(bag: Bag, topic: Topic | None) -> Iterator[None]:
    """Prefix the message of a BagError with the bag and the topic."""
    try:
        yield
    except BagError as error:
        raise BagError(f"{bag.path}: {topic.name if topic else 'a topic'}: {error}") from None


def _report_unexpected_topics(bag: Bag, topics: Mapping[str, Topic | None], namespace: str) -> None:
    """Report channels with the name but not the type of one of the worm's topics, and topics of several namespaces."""
    for name, topic in topics.items():
        ending = f"{namespace.rstrip('/')}/{name}"
        for other in bag.channels:
            kind = other.type_name or "message without a type", other.encoding
            is_named = other.name == topic.name if topic else f"/{other.name}".endswith(ending)
            if other.count and is_named and kind != (TYPES[name], "cdr"):
                bag.notify(
                    f"{bag.path}: {other.count} messages of {other.name} are not read: their type is {kind[0]} in "
                    f"{kind[1] or 'no encoding'}, not {TYPES[name]} in cdr"
                )
    roots = {topic.name.removesuffix(name) for name, topic in topics.items() if topic is not None}
    if len(roots) > 1:
        bag.notify(
            f"{bag.path}: topics under {', '.join(sorted(roots))} are read as topics of one robot; "
            "if they belong to several robots, choose one with --namespace"
        )


def namespace_of(bag: Bag) -> str:
    """Return the namespace of the robot in a bag, such as ``/worm``; empty for the root."""
    for name in RUN_TOPICS:
        topic = find_topic(bag.channels, name)
        if topic is not None:
            return topic.name.removesuffix(name).rstrip("/")
    raise _none_of_the_worms(bag)


def _none_of_the_worms(bag: Bag, where: str = "") -> NoRunError:
    names = ", ".join(bag.topics) or "none"
    return NoRunError(f"{bag.path} has none of the worm's topics{where}; it has {names}")


def received_at(bag: Bag, name: str) -> dict[int, int]:
    """Return the log times of the messages of one of the worm's topics, by stamp; both in ns since the epoch."""
    received: dict[int, int] = {}
    topic = find_topic(bag.channels, name)
    for columns in _decoded(bag, {name: topic} if topic else {}):
        stamps = stamps_of(columns[name]).tolist()
        received.update(zip(stamps, columns[name].log_time.tolist(), strict=True))
    return received


def read_columns(bag: Bag, topic: Topic) -> MessageColumns:
    """Return all fields of a topic of a bag as columns; messages of another type of the topic are left out."""
    builder = ColumnBuilder()
    for block in bag.blocks([topic.name]):
        builder.add(block.like(topic))
    return builder.columns()


def _finite(columns: MessageColumns) -> tuple[MessageColumns, int]:
    """Return the columns without the messages that contain an infinite number, and the number of these messages."""
    infinite = np.zeros(len(columns.log_time), bool)
    for values in columns.numbers.values():
        if values.dtype != object:
            infinite |= np.isinf(values.reshape(len(values), -1)).any(axis=1)
    if not infinite.any():
        return columns, 0
    kept = np.flatnonzero(~infinite)
    numbers = {path: values[kept] for path, values in columns.numbers.items()}
    texts = {path: [texts[row] for row in kept] for path, texts in columns.texts.items()}
    return MessageColumns(numbers, texts, columns.log_time[kept]), int(infinite.sum())


def stamps_of(columns: MessageColumns, path: str = "header.stamp") -> NDArray[np.int64]:
    """Return the times in the field ``path`` of messages, ns since the epoch. Raises BagError without this field."""
    if not columns.numbers:
        return np.empty(0, np.int64)
    whole = _numbers(columns, f"{path}.sec", np.int64)
    stamp: NDArray[np.int64] = whole * 10**9 + _numbers(columns, f"{path}.nanosec", np.int64)
    return stamp


def clock_offset(bag: Bag, namespace: str) -> int:
    """Return the median of log time minus stamp (ns) of a bag's first lengths, positions or powers.

    A difference of at most one second is a normal delay; the function then returns 0. It also returns 0 for a bag
    without such messages.
    """
    for name in _INSTRUMENTS:
        topic = find_topic(bag.channels, name, namespace)
        for columns in islice(_decoded(bag, {name: topic}) if topic and topic.count else (), 1):
            late = columns[name].log_time - stamps_of(columns[name])
            shift = int(np.median(late)) if len(late) else 0
            return shift if abs(shift) > _LONGEST_DELAY_NS else 0
    return 0


def _numbers(columns: MessageColumns, path: str, kind: type = np.float64) -> NDArray[Any]:
    if path not in columns.numbers:
        raise BagError(
            f"the definition in the bag has no field {path}: it is not a definition of worm_msgs"
        )
    values = columns.numbers[path]
    if values.dtype == object:
        raise BagError(
            f"{path} is missing in some messages, or its length differs: the message type changes within the bag; cut "
            "the bag where the type changes: worm_model bags trim --help"
        )
    return values.astype(kind)


def _series(kind: type[Any], columns: MessageColumns) -> Any:
    """Return columns as samples of ``kind``, a class of `worm_model.run`; empty without columns."""
    nothing = kind()
    if not columns.numbers:
        return nothing
    arrays = {}
    for field in fields(kind):
        if field.name in _READERS:
            arrays[field.name] = _READERS[field.name](columns)
        else:
            number = getattr(nothing, field.name).dtype.type
            read = _numbers
            if field.name in _ABSENT:
                read = partial(_numbers_or_default, default=_ABSENT[field.name])
            arrays[field.name] = read(columns, path_of(field.name), number)
    return kind(**arrays)


def _numbers_or_default(
    columns: MessageColumns, path: str, kind: type, default: float
) -> NDArray[Any]:
    """Return the numbers of a field, with a default for older messages, whose type lacks the field."""
    size = len(next(iter(columns.numbers.values())))
    values = columns.numbers.get(path, np.full(size, default))
    if values.dtype == object:
        values = np.where(values == None, default, values)  # noqa: E711 - element by element
    return values.astype(kind)


def _joint_names(columns: MessageColumns) -> tuple[str, ...]:
    names = [texts for path, texts in columns.texts.items() if path.startswith("name[")]
    if any(set(texts) != {texts[0]} or texts[0] is None for texts in names):
        raise BagError("the joints of joint_states change within the bag")
    return tuple(str(texts[0]) for texts in names)


#: fields that messages of older recordings lack, with their defaults; run 0 means no run number
_ABSENT: Mapping[str, Any] = {**GAIT_DEFAULTS, "run": 0}
_READERS: Mapping[str, Callable[[MessageColumns], Any]] = {
    "stamp": stamps_of,
    "onset": partial(stamps_of, path="onset"),
    "names": _joint_names,
    "content": lambda columns: np.array(columns.texts["content"], object),
}
