# SPDX-License-Identifier: Apache-2.0
"""rosbag2's ``metadata.yaml``, version 9 (ROS 2 Jazzy), as plain data."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

VERSION = 9
ROOT = "rosbag2_bagfile_information"


@dataclass(frozen=True)
class RecordedTopic:
    """A topic as a bag knows it.

    Attributes:
        name: full topic name, beginning with ``/``.
        type_name: ``package/msg/Type``.
        schema: ``ros2msg`` text of the type and all that it needs.
        type_hash: RIHS01 hash of the type, empty when it is not known.
        offered_qos: QoS profiles of the publishers as rosbag2 version 9 writes them.
    """

    name: str
    type_name: str
    schema: str
    type_hash: str = ""
    offered_qos: tuple[Mapping[str, Any], ...] = ()

    def qos_yaml(self) -> str:
        """The QoS profiles as a YAML list; empty when none are known, which readers take for none."""
        return yaml.safe_dump(list(self.offered_qos), sort_keys=False) if self.offered_qos else ""


@dataclass
class Extent:
    """Number of messages and the span of their log times (ns since the epoch)."""

    count: int = 0
    first: int = 0
    last: int = 0

    def add(self, time: int) -> None:
        """Widen by one message."""
        self.first = min(self.first, time) if self.count else time
        self.last = max(self.last, time) if self.count else time
        self.count += 1

    def fields(self) -> dict[str, Any]:
        """As metadata.yaml writes it."""
        return {
            "duration": {"nanoseconds": self.last - self.first},
            "starting_time": {"nanoseconds_since_epoch": self.first},
            "message_count": self.count,
        }


@dataclass
class BagSummary:
    """What metadata.yaml tells of a bag."""

    total: Extent = field(default_factory=Extent)
    files: dict[str, Extent] = field(default_factory=dict)
    topics: dict[str, RecordedTopic] = field(default_factory=dict)
    counts: dict[str, int] = field(default_factory=dict)
    custom: dict[str, str] = field(default_factory=dict)
    ros_distro: str = "jazzy"

    def document(self) -> dict[str, Any]:
        """The content of metadata.yaml below its root key."""
        return {
            "version": VERSION,
            "storage_identifier": "mcap",
            **self.total.fields(),
            "topics_with_message_count": [
                {"topic_metadata": _topic(topic), "message_count": self.counts.get(name, 0)}
                for name, topic in self.topics.items()
            ],
            "compression_format": "",
            "compression_mode": "",
            "relative_file_paths": list(self.files),
            "files": [{"path": name, **extent.fields()} for name, extent in self.files.items()],
            "custom_data": dict(self.custom),
            "ros_distro": self.ros_distro,
        }

    def text(self) -> str:
        """The content of metadata.yaml below its root key, as the MCAP record "rosbag2" repeats it."""
        return yaml.safe_dump(self.document(), sort_keys=False)


def _topic(topic: RecordedTopic) -> dict[str, Any]:
    return {
        "name": topic.name,
        "type": topic.type_name,
        "serialization_format": "cdr",
        "offered_qos_profiles": [dict(profile) for profile in topic.offered_qos],
        "type_description_hash": topic.type_hash,
    }


def write_metadata(directory: Path, summary: BagSummary) -> None:
    """Write metadata.yaml so that a crash leaves the old or the new one, whole.

    Raises:
        OSError: the disk is full or gone.
    """
    target = directory / "metadata.yaml"
    draft = directory / "metadata.yaml.tmp"
    with draft.open("w", encoding="utf-8") as stream:
        yaml.safe_dump({ROOT: summary.document()}, stream, sort_keys=False)
        stream.flush()
        os.fsync(stream.fileno())
    draft.replace(target)
    sync_directory(directory)


def sync_directory(directory: Path) -> None:
    """Make the names in a directory survive a power cut."""
    handle = os.open(directory, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def qos_profile(
    history: str,
    depth: int,
    reliability: str,
    durability: str,
    liveliness: str,
    times: Sequence[int],
) -> dict[str, Any]:
    """One offered QoS profile as rosbag2 version 9 writes it.

    Args:
        history, reliability, durability, liveliness: rosbag2's names, such as ``keep_last``, ``reliable``.
        depth: number of samples kept.
        times: deadline, lifespan and liveliness lease duration, ns.
    """
    deadline, lifespan, lease = ({"sec": t // 10**9, "nsec": t % 10**9} for t in times)
    return {
        "history": history,
        "depth": depth,
        "reliability": reliability,
        "durability": durability,
        "deadline": deadline,
        "lifespan": lifespan,
        "liveliness": liveliness,
        "liveliness_lease_duration": lease,
        "avoid_ros_namespace_conventions": False,
    }
