# SPDX-License-Identifier: Apache-2.0
"""Writes a run's arrays as the messages that the driver and the tracker publish."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from worm_model.bags.bag_errors import BagError
from worm_model.bags.bag_writer import BagWriter
from worm_model.bags.blocks import block_of_topics
from worm_model.bags.cdr import encode
from worm_model.bags.definitions import installed_types, topic_of
from worm_model.bags.payloads import Payloads
from worm_model.bags.worm_topics import TYPES, offered_qos
from worm_model.run import LengthSamples, Run, Stamps

Numbers = Mapping[str, NDArray[Any] | float]
LENGTH_SOURCES = {"commanded": 0, "cable": 1, "estimated": 2, "measured": 3}  # BodyLength.source


def write_run(writer: BagWriter, run: Run, namespace: str = "/worm") -> None:
    """Append a run's samples by rising stamp; each is taken to be received and sent at its stamp.

    Raises:
        BagError: the definitions of worm_msgs are not installed.
    """
    messages: dict[str, Payloads] = {}
    for name, stamp, numbers in _series(run):
        if len(stamp):
            topic = topic_of(f"{namespace.rstrip('/')}/{name}", TYPES[name], offered_qos(name))
            writer.add_topic(topic)
            messages[topic.name] = encode_stamped(TYPES[name], stamp, numbers)
    writer.write_block(block_of_topics(messages))


def encode_stamped(
    type_name: str, stamp: Stamps, numbers: Numbers, texts: Mapping[str, Any] | None = None
) -> Payloads:
    """CDR messages of a type with a header, from stamps (ns since the epoch) and columns; received at their stamps.

    Raises:
        BagError: a stamp is from before the epoch, or the type has no such field.
    """
    if len(stamp) and stamp.min() < 0:
        raise BagError(f"a {type_name} is from before 1970, which no bag can hold")
    header = {"header.stamp.sec": stamp // 10**9, "header.stamp.nanosec": stamp % 10**9}
    return encode(stamp, type_name, installed_types(type_name), {**header, **numbers}, texts or {})


def _series(run: Run) -> list[tuple[str, Stamps, Numbers]]:
    """Name, stamps and columns of each topic."""
    lengths = [_length(name, getattr(run, name)) for name in LENGTH_SOURCES]
    tracker, power = run.tracker, run.power
    return [
        _gait_states(run),
        *lengths,
        (
            "tracker",
            tracker.stamp,
            {"rear_position": tracker.rear_position, "front_position": tracker.front_position},
        ),
        (
            "power",
            power.stamp,
            {
                "status": power.status,
                "bus_voltage": power.bus_voltage,
                "current": power.current,
                "power": power.power,
            },
        ),
    ]


def _length(name: str, samples: LengthSamples) -> tuple[str, Stamps, Numbers]:
    numbers: Numbers = {
        "source": float(LENGTH_SOURCES[name]),
        "length": samples.length,
        "length_change": samples.length_change,
    }
    return f"body_length/{name}", samples.stamp, numbers


def _gait_states(run: Run) -> tuple[str, Stamps, Numbers]:
    states = run.gait_state
    numbers: Numbers = {
        "state": states.state,
        "gait.stroke": states.stroke,
        "gait.frequency": states.frequency,
        "gait.direction": states.direction,
        "gait.margin": states.margin,
        "onset.sec": np.asarray(states.onset) // 10**9,
        "onset.nanosec": np.asarray(states.onset) % 10**9,
        "run": states.run,
        "cycle": states.cycle,
        "cycles": states.cycles,
    }
    return "gait_state", states.stamp, numbers
