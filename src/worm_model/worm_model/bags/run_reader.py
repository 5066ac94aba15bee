# SPDX-License-Identifier: Apache-2.0
"""Conversion of the worm's topics in a bag to arrays."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import fields
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from worm_model.bags.bag import Bag
from worm_model.bags.bag_errors import BagError
from worm_model.bags.formats.cdr import ColumnBuilder, Columns
from worm_model.bags.formats.message_block import Topic
from worm_model.bags.worm_topics import SERIES, TYPES, find_topic, path_of
from worm_model.gait import GAIT_DEFAULTS
from worm_model.run import Run

RUN_TOPICS = tuple(SERIES)


def read_run(bag: Bag, namespace: str = "", names: Sequence[str] = RUN_TOPICS) -> Run:
    """Return the worm's samples in a bag.

    Args:
        bag: an open bag.
        namespace: namespace of the robot; empty: the only one in the bag.
        names: topics to read, from RUN_TOPICS.

    Raises:
        BagError: The bag has several robots, none of the topics, or data that cannot be decoded.
    """
    topic_of = {name: find_topic(bag.topics.values(), name, namespace) for name in names}
    topics = {name: topic for name, topic in topic_of.items() if topic is not None}
    if not topics:
        raise _none_of_the_worms(bag, f" under {namespace}" if namespace else "")
    _tell_odd_topics(bag, topic_of, namespace)
    columns = {
        name: _samples(bag, name, columns)
        for name, columns in read_columns(bag, list(topics.values())).items()
    }
    samples = {name: columns[topic.name] for name, topic in topics.items()}
    stamps = []
    for name, topic in topics.items():
        with _located(bag, topic):
            stamps.append(_stamp(samples[name]))
    for topic, stamp in zip(topics.values(), stamps, strict=True):
        if backwards := np.count_nonzero(np.diff(stamp) < 0):
            bag.notify(
                f"{bag.path}: stamps of {topic.name} go back {backwards} times: runs that were merged, "
                "several publishers, or a clock that was set"
            )
    series = {}
    for name, (attribute, kind) in SERIES.items():
        with _located(bag, topics.get(name)):
            series[attribute] = _series(kind, samples.get(name))
    if series["gait_state"].mixed:
        raise BagError(
            f"{bag.path}: runs of gaits overlap, as where recordings were merged or two drivers published at once: "
            "give the recordings one by one, or name the robot with --namespace"
        )
    return Run(origin=int(min((s.min() for s in stamps if len(s)), default=0)), **series)


@contextmanager
def _located(bag: Bag, topic: Topic | None) -> Iterator[None]:
    """Prefix the message of a BagError with the bag and the topic."""
    try:
        yield
    except BagError as error:
        raise BagError(f"{bag.path}: {topic.name if topic else 'a topic'}: {error}") from None


def _tell_odd_topics(bag: Bag, topics: Mapping[str, Topic | None], namespace: str) -> None:
    """Report topics with a worm's name but another type, and topics under several namespaces."""
    for name, topic in topics.items():
        ending = f"{namespace.rstrip('/')}/{name}"
        others = [t for t in bag.topics.values() if t.count and f"/{t.name}".endswith(ending)]
        for other in others if topic is None else ():
            kind = other.type_name or "message without a type"
            bag.notify(f"{bag.path}: {other.name} is not read: it is a {kind}, not {TYPES[name]}")
    roots = {topic.name.removesuffix(name) for name, topic in topics.items() if topic is not None}
    if len(roots) > 1:
        bag.notify(
            f"{bag.path}: topics of {', '.join(sorted(roots))} are taken for those of one robot; "
            "choose with --namespace if they are not"
        )


def namespace_of(bag: Bag) -> str:
    """Return the namespace of the robot in a bag, such as ``/worm``; empty for the root.

    Raises:
        BagError: The bag has several robots, or none.
    """
    for name in RUN_TOPICS:
        topic = find_topic(bag.topics.values(), name)
        if topic is not None:
            return topic.name.removesuffix(name).rstrip("/")
    raise _none_of_the_worms(bag)


def _none_of_the_worms(bag: Bag, where: str = "") -> BagError:
    names = ", ".join(bag.topics) or "none"
    return BagError(f"{bag.path} has none of the worm's topics{where}; it has {names}")


def read_columns(bag: Bag, topics: Sequence[Topic]) -> dict[str, Columns]:
    """Return all fields of some topics of a bag as columns, by topic name.

    Raises:
        BagError: A topic cannot be decoded.
    """
    builders = {topic.name: ColumnBuilder() for topic in topics}
    for block in bag.blocks(builders):
        for name, messages in block.by_topic():
            builders[name].add(messages)
    return {name: builder.columns() for name, builder in builders.items()}


def _samples(bag: Bag, name: str, columns: Columns) -> Columns:
    """Return the columns without repeated messages and without those with an infinite number; report both.

    Messages repeat their predecessor in a recording that was merged with itself.
    """
    numbers = {path: v for path, v in columns.numbers.items() if v.dtype != object}
    if not numbers:
        return columns
    size = len(next(iter(numbers.values())))
    again, infinite = np.arange(size) > 0, np.zeros(size, bool)
    for values in numbers.values():
        rows = values.reshape(size, -1)
        same = (rows[1:] == rows[:-1]) | ((rows[1:] != rows[1:]) & (rows[:-1] != rows[:-1]))
        again[1:] &= same.all(axis=1)
        infinite |= np.isinf(rows).any(axis=1)
    if again.any():
        bag.notify(
            f"{bag.path}: {np.count_nonzero(again)} messages of {name} are there twice; each counts once"
        )
    infinite &= ~again
    if infinite.any():
        bag.notify(
            f"{bag.path}: {np.count_nonzero(infinite)} messages of {name} hold an infinite number; they are left out"
        )
    kept = np.flatnonzero(~(again | infinite))
    if len(kept) == size:
        return columns
    return Columns(
        {path: values[kept] for path, values in columns.numbers.items()},
        {path: [texts[row] for row in kept] for path, texts in columns.texts.items()},
    )


def _stamp(columns: Columns, path: str = "header.stamp") -> NDArray[np.int64]:
    if not columns.numbers:
        return np.empty(0, np.int64)
    whole = _numbers(columns, f"{path}.sec", np.int64)
    stamp: NDArray[np.int64] = whole * 10**9 + _numbers(columns, f"{path}.nanosec", np.int64)
    return stamp


def _numbers(columns: Columns, path: str, kind: type = np.float64) -> NDArray[Any]:
    if path not in columns.numbers:
        raise BagError(
            f"the definition in the bag has no field {path}: it is not that of worm_msgs"
        )
    values = columns.numbers[path]
    if values.dtype == object:
        raise BagError(
            f"{path} is missing in some of its messages, or differs in length: its type changes within the bag; cut "
            "the bag where it does: worm_model bags trim --help"
        )
    return values.astype(kind)


def _series(kind: type[Any], columns: Columns | None) -> Any:
    """Return the columns as samples of a class of `worm_model.run`."""
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


def _numbers_or_default(columns: Columns, path: str, kind: type, default: float) -> NDArray[Any]:
    """Return the numbers of a field, with a default for messages from before the field existed."""
    size = len(next(iter(columns.numbers.values())))
    values = columns.numbers.get(path, np.full(size, default))
    if values.dtype == object:
        values = np.where(values == None, default, values)  # noqa: E711 - element by element
    return values.astype(kind)


def _joint_names(columns: Columns) -> tuple[str, ...]:
    names = [texts for path, texts in columns.texts.items() if path.startswith("name[")]
    if any(set(texts) != {texts[0]} or texts[0] is None for texts in names):
        raise BagError("the joints of joint_states change within the bag")
    return tuple(str(texts[0]) for texts in names)


#: fields that messages of older recordings lack, with their defaults; run 0 means no run number
_ABSENT: Mapping[str, Any] = {**GAIT_DEFAULTS, "run": 0}
_READERS: Mapping[str, Callable[[Columns], Any]] = {
    "stamp": _stamp,
    "onset": partial(_stamp, path="onset"),
    "names": _joint_names,
    "content": lambda columns: np.array(columns.texts["content"], object),
}
