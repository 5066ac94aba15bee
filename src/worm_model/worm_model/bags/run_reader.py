# SPDX-License-Identifier: Apache-2.0
"""Conversion of the worm's topics in a bag to arrays."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import fields
from functools import partial
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

from worm_model.bags.formats.bag_errors import BagError, NoRunError
from worm_model.bags.formats.cdr import ColumnBuilder, MessageColumns
from worm_model.bags.formats.message_block import Topic
from worm_model.bags.opening import Bag
from worm_model.bags.worm_topics import SERIES, TWIN_INPUTS, TYPES, find_topic, path_of
from worm_model.run import GaitStates, Run, Stamps, concatenated
from worm_msgs.gait import GAIT_DEFAULTS

RUN_TOPICS = tuple(SERIES)
# all except gait_state, whose last message may be much older than the recording
_INSTRUMENTS = TWIN_INPUTS[1:]
# largest normal delay from the stamp of a message to its reception by the recorder
_LONGEST_DELAY_NS = 10**9
# largest number of messages (a quarter of an hour of a recording) whose decoded samples stay in memory
MOST_KEPT = 250_000


def read_run(bag: Bag, namespace: str = "", names: Sequence[str] = RUN_TOPICS) -> Run:
    """Return the worm's samples in a bag.

    Args:
        bag: an open bag.
        namespace: namespace of the robot; empty: the only one in the bag.
        names: topics to read, from RUN_TOPICS.

    Raises:
        BagError: The bag has several robots or none of the topics, its data cannot be decoded, runs of gaits overlap,
            or the joints change within the bag.
    """
    parts = list(RunReader(bag, namespace, names).parts())
    series = {}
    for attribute, kind in SERIES.values():
        try:
            series[attribute] = concatenated(kind, [getattr(part, attribute) for part in parts])
        except ValueError:
            raise BagError(
                f"{bag.path}: the joints of joint_states change within the bag"
            ) from None
    return Run(origin=min((part.origin for part in parts if part.origin), default=0), **series)


class RunReader:
    """Reader of the worm's samples in a bag, part by part, so that memory does not grow with the bag.

    Args:
        bag, namespace, names: see `read_run`.
    """

    def __init__(self, bag: Bag, namespace: str, names: Sequence[str]) -> None:
        self._bag = bag
        topic_of = {name: find_topic(bag.channels, name, namespace) for name in names}
        self._topics = {name: topic for name, topic in topic_of.items() if topic is not None}
        if not self._topics:
            raise _none_of_the_worms(bag, f" under {namespace}" if namespace else "")
        _report_unexpected_topics(bag, topic_of, namespace)
        self._kept: list[Run] | None = None
        self._is_read = False

    def parts(self) -> Iterator[Run]:
        """Yield the samples in the order of reception, in parts, each from about a megabyte of the bag.

        The first complete iteration reports infinite numbers and stamps that go back. If the
        topics have more than MOST_KEPT messages, further iterations read the bag again.
        """
        if self._kept is not None:
            yield from self._kept
            return
        kept: list[Run] | None = []
        if sum(topic.count for topic in self._topics.values()) > MOST_KEPT or self._is_read:
            kept = None
        filters = {name: _Filter() for name in self._topics}
        states: list[GaitStates] = []
        for part in self._read(filters):
            states.append(part.gait_state)
            if kept is not None:
                kept.append(part)
            yield part
        if not self._is_read:
            self._report(filters)
        if concatenated(GaitStates, states).mixed:
            raise BagError(
                f"{self._bag.path}: runs of gaits overlap; recordings were merged, or two drivers published together: "
                "give the recordings one by one, or name the robot with --namespace"
            )
        self._kept, self._is_read = kept, True

    def _read(self, filters: Mapping[str, _Filter]) -> Iterator[Run]:
        names = {topic.name: name for name, topic in self._topics.items()}
        for block in self._bag.blocks(names):
            columns = {}
            for topic, messages in block.by_topic():
                builder, name = ColumnBuilder(), names[topic]
                builder.add(messages.like(self._topics[name]))
                columns[name] = filters[name].filter(builder.columns())
            series, stamps = {}, []
            for name, (attribute, kind) in SERIES.items():
                with _located(self._bag, self._topics.get(name)):
                    series[attribute] = _series(kind, columns.get(name))
                    stamps.append(series[attribute].stamp)
                    if name in filters:
                        filters[name].count_backwards(stamps[-1])
            origin = min((int(stamp.min()) for stamp in stamps if len(stamp)), default=0)
            yield Run(origin=origin, **series)

    def _report(self, filters: Mapping[str, _Filter]) -> None:
        for name, counts in filters.items():
            topic = self._topics[name].name
            for count, text in (
                (
                    counts.infinite,
                    "{} messages of {} contain an infinite number and are excluded",
                ),
                (
                    counts.backwards,
                    "{} stamps of {} go back: merged runs, several publishers, or a clock that was set",
                ),
            ):
                if count:
                    self._bag.notify(f"{self._bag.path}: {text.format(count, topic)}")


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
    for block in bag.blocks([topic.name] if topic else []):
        builder, messages = ColumnBuilder(), block.like(topic) if topic else block
        builder.add(messages)
        received.update(
            zip(stamps_of(builder.columns()).tolist(), messages.log_time.tolist(), strict=True)
        )
    return received


def read_columns(bag: Bag, topics: Sequence[Topic]) -> dict[str, MessageColumns]:
    """Return all fields of some topics of a bag as columns, by topic name; other types of a topic are left out."""
    by_name = {topic.name: topic for topic in topics}
    builders = {name: ColumnBuilder() for name in by_name}
    for block in bag.blocks(builders):
        for name, messages in block.by_topic():
            builders[name].add(messages.like(by_name[name]))
    return {name: builder.columns() for name, builder in builders.items()}


class _Filter:
    """Filter of one topic's messages; it excludes and counts messages with an infinite number.

    Attributes:
        infinite: number of excluded messages.
        backwards: number of stamps that are smaller than the previous one.
    """

    def __init__(self) -> None:
        self.infinite = self.backwards = 0
        self._last_stamp: Stamps = np.empty(0, np.int64)

    def filter(self, columns: MessageColumns) -> MessageColumns:
        """Return the columns of the next messages without the excluded messages."""
        infinite = [
            np.isinf(values.reshape(len(values), -1)).any(axis=1)
            for values in columns.numbers.values()
            if values.dtype != object
        ]
        excluded = np.any(infinite, axis=0)
        if not excluded.any():
            return columns
        self.infinite += int(np.count_nonzero(excluded))
        kept = np.flatnonzero(~excluded).tolist()
        return MessageColumns(
            {path: values[kept] for path, values in columns.numbers.items()},
            {path: [texts[row] for row in kept] for path, texts in columns.texts.items()},
        )

    def count_backwards(self, stamp: Stamps) -> None:
        """Count the stamps of the next messages that are smaller than the previous one."""
        self.backwards += int(np.count_nonzero(np.diff(stamp, prepend=self._last_stamp) < 0))
        self._last_stamp = np.append(self._last_stamp, stamp)[-1:]


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
        for block in islice(bag.blocks([topic.name]) if topic and topic.count else (), 1):
            builder, messages = ColumnBuilder(), block.like(topic) if topic else block
            builder.add(messages)
            late = messages.log_time.astype(np.int64) - stamps_of(builder.columns())
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


def _series(kind: type[Any], columns: MessageColumns | None) -> Any:
    """Return columns as samples of ``kind``, a class of `worm_model.run`; empty without columns."""
    nothing = kind()
    if columns is None or not columns.numbers:
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
