# SPDX-License-Identifier: Apache-2.0
"""Removal of data that identifies the recording computer: its host name, and absolute paths of files and devices."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from rosbags.serde import SerdeError

from worm_model.bags.formats.bag import Bag
from worm_model.bags.formats.bag_errors import BagError
from worm_model.bags.formats.bag_writer import ROSBAG2_RECORD, new_bag
from worm_model.bags.formats.cdr import defined_message
from worm_model.bags.formats.contents import AttachedFile
from worm_model.bags.formats.message_block import Message
from worm_model.bags.formats.message_types import typestore, with_definition
from worm_model.bags.recording.recorder import Manifest
from worm_model.bags.recording.run_manifest import HOST, RUN_RECORD

_PATH = re.compile(r"(?<![\w./])~?/(?:[^\s/'\",;=<>()\[\]{}]+/)+[^\s/'\",;=<>()\[\]{}]*")
HOST_PLACEHOLDER = "host"


class Cleaner:
    """Cleaner that removes host name and absolute paths from texts, manifests and messages.

    Args:
        host: name of the computer, replaced wherever it occurs; empty: unknown.
        topics: topic names. A path that begins with the first part of one of them (the robot's namespace) is a ROS
            name and is not changed.

    Attributes:
        changed: number of messages with a replaced text.
    """

    def __init__(self, host: str, topics: Iterable[str]) -> None:
        self.changed = 0
        self._roots = {name.lstrip("/").split("/")[0] for name in topics}
        self._host = re.compile(rf"(?<![\w-]){re.escape(host)}(?![\w-])") if host else None

    def add_topics(self, topics: Iterable[str]) -> None:
        """Treat paths under the namespaces of further topics as ROS names, too."""
        self._roots.update(name.lstrip("/").split("/")[0] for name in topics)

    def text(self, text: str) -> str:
        """Return a text in which each path is replaced by its last part, and the host name by a placeholder."""
        if "/" in text:
            text = _PATH.sub(self._last_part, text)
        return self._host.sub(HOST_PLACEHOLDER, text) if self._host else text

    def _last_part(self, match: re.Match[str]) -> str:
        path = match.group()
        root = path.lstrip("~/").split("/")[0]
        return path if root in self._roots else path.rstrip("/").rpartition("/")[2]

    def values(self, values: Mapping[str, str]) -> dict[str, str]:
        """Return a metadata record with clean texts and without its entry for the host."""
        return {key: self.text(value) for key, value in values.items() if key != HOST}

    def attachment(self, attached: AttachedFile) -> AttachedFile:
        """Return a file, cleaned if it is text."""
        try:
            text = attached.data.decode()
        except UnicodeDecodeError:
            return attached
        return replace(attached, data=self.text(text).encode())

    def manifest(self, manifest: Manifest) -> Manifest:
        """Return a recording's manifest with clean texts."""
        return Manifest(
            {name: self.values(values) for name, values in manifest.metadata.items()},
            tuple(map(self.attachment, manifest.attachments)),
        )

    def message(self, message: Message) -> Message:
        """Return a message with clean texts; its bytes are unchanged if no text changes.

        Raises:
            BagError: The message cannot be decoded.
        """
        topic = message.channel
        if topic.encoding != "cdr":
            raise BagError(f"{topic.name} is encoded as {topic.encoding!r} and cannot be cleaned")
        store = typestore(topic.type_name, topic.definition, topic.definition_format)
        try:
            content = store.deserialize_cdr(message.data, topic.type_name)
        except SerdeError as error:
            reason = " ".join(str(error).split())
            raise BagError(f"{topic.name}: a message cannot be decoded: {reason}") from None
        if not _clean_texts(content, self.text):
            return message
        self.changed += 1
        return message._replace(data=bytes(store.serialize_cdr(content, topic.type_name)))


def _clean_texts(content: Any, clean: Callable[[str], str]) -> bool:
    """Clean all texts of a message in place; return True if a text changed."""
    items = vars(content).items() if hasattr(content, "__msgtype__") else enumerate(content)
    changed = False
    for key, value in list(items):
        if isinstance(value, str) and key != "__msgtype__":
            cleaned = clean(value)
            if cleaned != value:
                changed = True
                if isinstance(content, list):
                    content[key] = cleaned
                else:
                    setattr(content, str(key), cleaned)
        elif isinstance(value, list) or hasattr(value, "__msgtype__"):
            changed |= _clean_texts(value, clean)
    return changed


def clean_bag(bag: Bag, output: Path) -> Cleaner:
    """Write a copy of a bag without host name and absolute paths; return the cleaner, which counts the changes.

    Raises:
        BagError: The output exists, a topic has no definition, or a message cannot be decoded.
    """
    host = bag.metadata.get(RUN_RECORD, {}).get(HOST, "")
    cleaner = Cleaner(host, bag.topics)
    with new_bag(output) as writer:
        for attached in bag.attachments():
            writer.add_attachment(cleaner.attachment(attached))
        for record in bag.records:
            if record.name != ROSBAG2_RECORD:
                writer.add_metadata(record.name, cleaner.values(dict(record.values)))
        for channel in bag.channels:
            writer.add_topic(with_definition(channel))
        writer.write_all(cleaner.message(defined_message(m)) for m in bag.messages())
    return cleaner
