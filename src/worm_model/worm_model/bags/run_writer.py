# SPDX-License-Identifier: Apache-2.0
"""Conversion of a run's arrays to the messages that the driver and the tracker publish."""

from __future__ import annotations

import heapq
from collections.abc import Mapping
from dataclasses import fields
from operator import attrgetter, itemgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from worm_model.bags.formats.bag_errors import BagError
from worm_model.bags.formats.bag_writer import BagWriter
from worm_model.bags.formats.cdr import encode
from worm_model.bags.formats.message_block import Message, Topic
from worm_model.bags.formats.message_types import topic_of
from worm_model.bags.worm_topics import BODY_LENGTH, SERIES, TYPES, offered_qos, path_of
from worm_model.run import LengthSource, Run, Stamps

Numbers = Mapping[str, NDArray[Any] | float]


def write_run(writer: BagWriter, run: Run, namespace: str = "/worm") -> None:
    """Append the samples of a run, except joint states, in order of stamp.

    The publish time and the log time of each message equal its stamp.
    """
    series = []
    for name, (attribute, _) in SERIES.items():
        samples = getattr(run, attribute)
        if len(samples.stamp) and name != "joint_states":
            numbers = _columns(samples)
            if TYPES[name] == BODY_LENGTH:
                numbers["source"] = LengthSource[attribute.upper()]
            topic = topic_of(f"{namespace.rstrip('/')}/{name}", TYPES[name], offered_qos(name))
            writer.add_topic(topic)
            series.append(stamped_messages(topic, samples.stamp, numbers))
    writer.write_all(heapq.merge(*series, key=attrgetter("log_time")))


def stamped_messages(
    topic: Topic, stamp: Stamps, numbers: Numbers, texts: Mapping[str, Any] | None = None
) -> list[Message]:
    """Return messages of a type with a header, in order of stamp.

    The publish time and the log time of each message equal its stamp.

    Args:
        topic: topic of the messages.
        stamp: stamps, ns since the epoch, shape (n,).
        numbers, texts: values of the fields, see `cdr.encode`.
    """
    if len(stamp) and stamp.min() < 0:
        raise BagError(f"a {topic.type_name} has a stamp before 1970, which a bag cannot store")
    header = {"header.stamp.sec": stamp // 10**9, "header.stamp.nanosec": stamp % 10**9}
    data = encode(topic, len(stamp), {**header, **numbers}, texts or {})
    return [
        Message(topic.name, time, data[row], time, topic)
        for row, time in sorted(enumerate(stamp.tolist()), key=itemgetter(1))
    ]


def _columns(samples: Any) -> dict[str, Any]:
    """Return the fields of a series except its stamps, by their names in the message."""
    names = [field.name for field in fields(samples) if field.name not in ("stamp", "onset")]
    numbers = {path_of(name): getattr(samples, name) for name in names}
    if hasattr(samples, "onset"):
        numbers["onset.sec"], numbers["onset.nanosec"] = np.divmod(samples.onset, 10**9)
    return numbers
