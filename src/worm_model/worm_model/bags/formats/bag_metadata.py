# SPDX-License-Identifier: Apache-2.0
"""Reader and writer of rosbag2's ``metadata.yaml``, version 9 (ROS 2 Jazzy), and of other YAML in bags."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from textwrap import indent
from typing import Any

import yaml

from worm_model.bags.formats.bag_errors import BagError
from worm_model.bags.formats.finding import METADATA_FILE, check_readable
from worm_model.bags.formats.message_block import Topic

METADATA_ROOT = "rosbag2_bagfile_information"
VERSION = 9
STATE = "state"  # key in custom_data of a bag that this package records
UNFINISHED, CLOSED = "being recorded", "closed"  # its values
FOREVER = (2**63 - 1,) * 3  # ns; times of a QoS profile without limits
_LOADER: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # C is ten times faster
_DUMPER: Any = getattr(yaml, "CSafeDumper", yaml.SafeDumper)


@dataclass
class LogTimes:
    """Number of messages and span of their log times (ns since the epoch)."""

    count: int = 0
    first: int = 0
    last: int = 0

    def add(self, time: int) -> None:
        """Count a message and extend the span to its log time (ns)."""
        self.first = min(self.first, time) if self.count else time
        self.last = max(self.last, time) if self.count else time
        self.count += 1

    def fields(self) -> dict[str, Any]:
        """Return the fields of metadata.yaml."""
        return {
            "duration": {"nanoseconds": self.last - self.first},
            "starting_time": {"nanoseconds_since_epoch": self.first},
            "message_count": self.count,
        }


# --- reading --------------------------------------------------------------------------------------


def read_metadata(directory: Path) -> dict[str, Any]:
    """Return the content of a bag's metadata.yaml below its root key."""
    path = directory / METADATA_FILE
    if not path.exists():
        raise BagError(f"{path} is missing")
    check_readable(path)
    try:
        whole = yaml.load(path.read_text(encoding="utf-8"), Loader=_LOADER) or {}
        content = whole[METADATA_ROOT]
        if not all(isinstance(name, str) for name in content["relative_file_paths"]):
            raise TypeError("relative_file_paths contains other values than names")
    except (OSError, ValueError, yaml.YAMLError, RecursionError, LookupError, TypeError) as error:
        reason = " ".join(f"{type(error).__name__}: {error}".split())
        raise BagError(f"{path} cannot be read as the metadata of rosbag2 ({reason})") from None
    return dict(content)


def is_unfinished(content: Mapping[str, Any]) -> bool:
    """Return True if a bag's metadata shows that its recorder has not closed it."""
    custom = content.get("custom_data")
    return isinstance(custom, dict) and custom.get(STATE) == UNFINISHED


def is_unclosed(path: Path) -> bool:
    """Return True if a folder is a bag that its recorder has not closed."""
    try:
        return is_unfinished(read_metadata(path))
    except BagError:
        return any(path.glob("*.mcap"))  # killed before its metadata.yaml was written


def qos_profiles(text: str) -> list[Any]:
    """Return the QoS profiles of a channel in the format of version 9, which has names in place of the numbers.

    Returns an empty list if the text is not a list of profiles.
    """
    try:
        profiles = yaml.load(text, Loader=_LOADER)
        if re.search(r"durability: *\d", text):
            from rosbags.rosbag2.metadata import dump_qos_v9, parse_qos  # here: these load slowly

            profiles = dump_qos_v9(parse_qos(profiles))
    except Exception:  # noqa: BLE001 - the library also raises AssertionError
        return []
    return profiles if isinstance(profiles, list) else []


def first_qos_profile(topic: Topic) -> dict[str, Any]:
    """Return the QoS profile that a topic's first publisher offered; empty if the bag does not contain the profile."""
    first, *_ = qos_profiles(topic.offered_qos) or [None]
    return first if isinstance(first, dict) else {}


def is_latched(topic: Topic) -> bool:
    """Return True if a topic was published with transient-local durability: later subscribers receive it."""
    return first_qos_profile(topic).get("durability") == "transient_local"


# --- writing --------------------------------------------------------------------------------------


class _Dumper(_DUMPER):
    """YAML writer that writes each further occurrence of an object in full, not as a reference to the first."""

    def ignore_aliases(self, data: Any) -> bool:  # noqa: ARG002 - applies to any data
        return True


def dump_yaml(document: Any) -> str:
    """Return YAML text without references."""
    text: str = yaml.dump(document, Dumper=_Dumper, sort_keys=False)
    return text


def metadata_text(
    total: LogTimes,
    topics: Iterable[tuple[Topic, int]],
    files: Mapping[str, LogTimes],
    custom: Mapping[str, str],
) -> str:
    """Return the content of metadata.yaml below its root key.

    The metadata record "rosbag2" in an MCAP file contains the same text, with empty lists of files.

    Args:
        total: number of messages of the bag and their time span.
        topics: topics with their numbers of messages.
        files: number of messages and time span of each file, by file name.
        custom: entries that the writer adds for its own use.
    """
    return dump_yaml(
        {
            "version": VERSION,
            "storage_identifier": "mcap",
            **total.fields(),
            "topics_with_message_count": [
                {"topic_metadata": _describe(topic), "message_count": count}
                for topic, count in topics
            ],
            "compression_format": "",
            "compression_mode": "",
            "relative_file_paths": list(files),
            "files": [{"path": name, **extent.fields()} for name, extent in files.items()],
            "custom_data": dict(custom),
            "ros_distro": os.environ.get("ROS_DISTRO", ""),
        }
    )


def _describe(topic: Topic) -> dict[str, Any]:
    return {
        "name": topic.name,
        "type": topic.type_name,
        "serialization_format": topic.encoding,
        "offered_qos_profiles": qos_profiles(topic.offered_qos),
        "type_description_hash": topic.type_hash,
    }


def write_metadata(directory: Path, text: str) -> None:
    """Replace metadata.yaml atomically: after a crash, either the old or the new file is complete.

    Args:
        directory: the bag.
        text: content below the root key.
    """
    unfinished = directory / f"{METADATA_FILE}.tmp"
    with unfinished.open("w", encoding="utf-8") as stream:
        stream.write(f"{METADATA_ROOT}:\n{indent(text, '  ')}")
        stream.flush()
        os.fsync(stream.fileno())
    unfinished.replace(directory / METADATA_FILE)
    sync_directory(directory)


def sync_directory(directory: Path) -> None:
    """Write the names in a directory to the disk, so that they survive a power cut."""
    handle = os.open(directory, os.O_RDONLY | os.O_DIRECTORY)
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
    """Return one offered QoS profile in the format of version 9 of metadata.yaml.

    Args:
        history, reliability, durability, liveliness: rosbag2's names, such as ``keep_last``, ``reliable``.
        depth: number of stored samples.
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
