# SPDX-License-Identifier: Apache-2.0
"""Names and types of the worm's topics, and the search for these topics in a bag under any namespace."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

from worm_model.bags.formats.bag_errors import BagError
from worm_model.bags.formats.bag_metadata import FOREVER, dump_yaml, qos_profile
from worm_model.bags.formats.message_block import Topic
from worm_model.run import (
    GaitStates,
    JointSamples,
    LengthSamples,
    MemorySamples,
    PowerSamples,
    TrackerSamples,
)
from worm_msgs.gait import GAIT_UNITS

BODY_LENGTH = "worm_msgs/msg/BodyLength"
TRACKER = "worm_msgs/msg/Tracker"
POWER = "worm_msgs/msg/Power"
GAIT_STATE = "worm_msgs/msg/GaitState"
JOINT_STATE = "sensor_msgs/msg/JointState"
TWIN_STATE = "worm_msgs/msg/TwinState"
TWIN_RESIDUALS = "worm_msgs/msg/TwinResiduals"
TWIN_EVENT = "worm_msgs/msg/TwinEvent"
TWIN_MEMORY = "worm_msgs/msg/TwinMemory"
# types of topics that a recorder leaves out unless they are named, because a camera's images need 27 MB/s
IMAGES = frozenset({"sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"})

TYPES = {
    "body_length/commanded": BODY_LENGTH,
    "body_length/cable": BODY_LENGTH,
    "body_length/estimated": BODY_LENGTH,
    "body_length/measured": BODY_LENGTH,
    "tracker": TRACKER,
    "power": POWER,
    "gait_state": GAIT_STATE,
    "joint_states": JOINT_STATE,
    "twin/joint_states": JOINT_STATE,
    "twin/state": TWIN_STATE,
    "twin/residuals": TWIN_RESIDUALS,
    "twin/events": TWIN_EVENT,
    "twin/memory": TWIN_MEMORY,
}

#: attribute of `worm_model.run.Run` and class of its samples, by topic
SERIES: Mapping[str, tuple[str, type[Any]]] = {
    "gait_state": ("gait_state", GaitStates),
    "body_length/commanded": ("commanded", LengthSamples),
    "body_length/cable": ("cable", LengthSamples),
    "body_length/estimated": ("estimated", LengthSamples),
    "body_length/measured": ("measured", LengthSamples),
    "tracker": ("tracker", TrackerSamples),
    "power": ("power", PowerSamples),
    "joint_states": ("joint_states", JointSamples),
    "twin/memory": ("memory", MemorySamples),
}

LATCHED = frozenset({"gait_state", "twin/memory"})  # a later subscriber receives the last message
# Of the events, a later subscriber receives the last ten.
_TRANSIENT_LOCAL = LATCHED | {"twin/events"}
TWIN_INPUTS = (
    "gait_state",
    "body_length/commanded",
    "body_length/measured",
    "tracker",
    "power",
)
REPLAY_INPUTS = (*TWIN_INPUTS, "twin/memory")  # topics that a replay reads
TWIN_TOPICS = ("body_length/estimated", "twin/state", "twin/residuals", "twin/events")


def path_of(field: str) -> str:
    """Return the path of a sample's field in the message: ``gait.stroke`` for the field ``stroke``, for example."""
    return f"gait.{field}" if field in GAIT_UNITS else field


def offered_qos(name: str) -> str:
    """Return the QoS of one of the worm's topics (a key of TYPES) as YAML, in the format of a bag's channel."""
    durability = "transient_local" if name in _TRANSIENT_LOCAL else "volatile"
    depth = 1 if name in LATCHED else 10
    return dump_yaml(
        [qos_profile("keep_last", depth, "reliable", durability, "automatic", FOREVER)]
    )


def find_topic(channels: Iterable[Topic], name: str, namespace: str = "") -> Topic | None:
    """Return the topic with one of the worm's names (a key of TYPES) and its type, or None.

    Args:
        channels: channels of a bag. Channels of one topic with another type or encoding do not count.
        name: relative name, such as ``body_length/measured``.
        namespace: namespace of the topic, such as ``/worm``; empty: any.
    """
    ending = f"{namespace.rstrip('/')}/{name}" if namespace else f"/{name}"
    longer = tuple(f"/{other}" for other in TYPES if other.endswith(f"/{name}"))
    matching: dict[str, Topic] = {}
    for channel in channels:
        if (channel.type_name, channel.encoding) == (TYPES[name], "cdr") and (
            channel.name.lstrip("/") == ending.lstrip("/")
            if namespace
            else f"/{channel.name}".endswith(ending) and not f"/{channel.name}".endswith(longer)
        ):
            known = matching.get(channel.name)
            count = channel.count + (known.count if known else 0)
            matching[channel.name] = replace(channel, count=count)
    if len(matching) > 1:
        names = ", ".join(sorted(matching))
        raise BagError(f"several topics could be {name}: {names}; choose with --namespace")
    return next(iter(matching.values()), None)
