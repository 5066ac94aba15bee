# SPDX-License-Identifier: Apache-2.0
"""Reads the worm's topics of a bag into arrays."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from worm_model.bags.bag import Bag, Topic
from worm_model.bags.bag_errors import BagError
from worm_model.bags.cdr import Columns, decode, parse_types
from worm_model.bags.definitions import installed_types
from worm_model.bags.payloads import Payloads
from worm_model.bags.worm_topics import find_topic
from worm_model.run import (
    GaitStates,
    JointSamples,
    LengthSamples,
    PowerSamples,
    Run,
    TrackerSamples,
)

RUN_TOPICS = (
    "body_length/commanded",
    "body_length/cable",
    "body_length/estimated",
    "body_length/measured",
    "tracker",
    "power",
    "gait_state",
    "joint_states",
)


def read_run(bag: Bag, namespace: str = "", names: Sequence[str] = RUN_TOPICS) -> Run:
    """The worm's samples in a bag.

    Args:
        bag: an open bag.
        namespace: of the robot; empty: the one there is.
        names: of RUN_TOPICS, those that are read.

    Raises:
        BagError: the bag holds several robots, none of the topics, or something that cannot be decoded.
    """
    found = {name: find_topic(bag.topics.values(), name, namespace) for name in names}
    topics = {name: topic for name, topic in found.items() if topic is not None}
    if not topics:
        where = f" under {namespace}" if namespace else ""
        raise BagError(
            f"{bag.path} has none of the worm's topics{where}; it has {', '.join(bag.topics) or 'none'}"
        )
    columns = read_columns(bag, list(topics.values()))
    samples = {name: columns[topic.name] for name, topic in topics.items()}
    lengths = {name: _lengths(samples.get(name)) for name in RUN_TOPICS[:4]}
    stamps = [_stamp(c) for c in samples.values()]
    return Run(
        origin=int(min((s.min() for s in stamps if len(s)), default=0)),
        commanded=lengths["body_length/commanded"],
        cable=lengths["body_length/cable"],
        estimated=lengths["body_length/estimated"],
        measured=lengths["body_length/measured"],
        tracker=_tracker(samples.get("tracker")),
        power=_power(samples.get("power")),
        gait_state=_gait_states(samples.get("gait_state")),
        joint_states=_joints(samples.get("joint_states")),
    )


def namespace_of(bag: Bag) -> str:
    """Namespace of the robot in a bag, such as ``/worm``; empty for the root.

    Raises:
        BagError: the bag holds several robots, or none.
    """
    for name in RUN_TOPICS:
        topic = find_topic(bag.topics.values(), name)
        if topic is not None:
            return topic.name.removesuffix(name).rstrip("/")
    raise BagError(
        f"{bag.path} has none of the worm's topics; it has {', '.join(bag.topics) or 'none'}"
    )


def read_columns(bag: Bag, topics: list[Topic]) -> dict[str, Columns]:
    """All fields of some topics of a bag as columns, by topic name.

    Raises:
        BagError: a topic cannot be decoded.
    """
    payloads = bag.payloads([topic.name for topic in topics])
    return {topic.name: decode_topic(topic, payloads[topic.name]) for topic in topics}


def decode_topic(topic: Topic, payloads: Payloads) -> Columns:
    """Columns of messages of a topic, by the definition inside the bag, or by the installed one if it has none.

    Raises:
        BagError: they cannot be decoded.
    """
    if topic.encoding != "cdr":
        raise BagError(f"{topic.name} is encoded as {topic.encoding!r}; only cdr can be decoded")
    if topic.definition:
        types = parse_types(topic.type_name, topic.definition, topic.definition_format)
    else:
        types = installed_types(topic.type_name)
    try:
        return decode(payloads, topic.type_name, types)
    except BagError as error:
        raise BagError(f"{topic.name}: {error}") from None


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
    return columns.numbers[path].astype(kind)


def _lengths(columns: Columns | None) -> LengthSamples:
    if columns is None or not columns.numbers:
        return LengthSamples()
    return LengthSamples(
        _stamp(columns), _numbers(columns, "length"), _numbers(columns, "length_change")
    )


def _tracker(columns: Columns | None) -> TrackerSamples:
    if columns is None or not columns.numbers:
        return TrackerSamples()
    return TrackerSamples(
        _stamp(columns), _numbers(columns, "rear_position"), _numbers(columns, "front_position")
    )


def _power(columns: Columns | None) -> PowerSamples:
    if columns is None or not columns.numbers:
        return PowerSamples()
    return PowerSamples(
        _stamp(columns),
        _numbers(columns, "status", np.int64),
        _numbers(columns, "bus_voltage"),
        _numbers(columns, "current"),
        _numbers(columns, "power"),
    )


def _gait_states(columns: Columns | None) -> GaitStates:
    if columns is None or not columns.numbers:
        return GaitStates()
    return GaitStates(
        stamp=_stamp(columns),
        state=_numbers(columns, "state", np.int64),
        stroke=_numbers(columns, "gait.stroke"),
        frequency=_numbers(columns, "gait.frequency"),
        direction=_numbers(columns, "gait.direction", np.int64),
        margin=_numbers(columns, "gait.margin"),
        onset=_stamp(columns, "onset"),
        cycle=_numbers(columns, "cycle", np.int64),
        cycles=_numbers(columns, "cycles", np.int64),
        run=_run_numbers(columns),
    )


def _run_numbers(columns: Columns) -> NDArray[np.int64]:
    """Of gait states; bags from before runs had numbers have none."""
    return _numbers(columns, "run", np.int64) if "run" in columns.numbers else np.empty(0, np.int64)


def _joints(columns: Columns | None) -> JointSamples:
    if columns is None or not columns.numbers:
        return JointSamples()
    names = [texts for path, texts in columns.texts.items() if path.startswith("name[")]
    if any(set(texts) != {texts[0]} or texts[0] is None for texts in names):
        raise BagError("the joints of joint_states change within the bag")
    return JointSamples(
        tuple(str(texts[0]) for texts in names),
        _stamp(columns),
        _numbers(columns, "position"),
        _numbers(columns, "velocity"),
        _numbers(columns, "effort"),
    )
