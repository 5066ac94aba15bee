# SPDX-License-Identifier: Apache-2.0
"""Takes out of a bag what tells where it was recorded: the host's name, and absolute paths, devices among them."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from rosbags.serde import SerdeError

from worm_model.bags.bag import AttachedFile, Bag
from worm_model.bags.bag_errors import BagError
from worm_model.bags.bag_writer import ROSBAG2_RECORD, new_bag
from worm_model.bags.cdr import defined_message
from worm_model.bags.message_block import Message
from worm_model.bags.message_types import typestore, with_definition
from worm_model.bags.recorder import Manifest
from worm_model.bags.run_manifest import HOST, RUN_RECORD

_PATH = re.compile(r"(?<![\w./])~?/(?:[^\s/'\",;=<>()\[\]{}]+/)+[^\s/'\",;=<>()\[\]{}]*")
HOST_STANDS_IN = "host"


class Cleaner:
    """Cleans texts, manifests and messages.

    Args:
        host: name of the computer, replaced where it occurs; empty: not known.
        topics: names whose first part, the robot's namespace, marks a path as a ROS name, which stays.

    Attributes:
        changed: number of messages in which something was taken out.
    """

    def __init__(self, host: str, topics: Iterable[str]) -> None:
        self.changed = 0
        self._roots = {name.lstrip("/").split("/")[0] for name in topics}
        self._host = re.compile(rf"(?<![\w-]){re.escape(host)}(?![\w-])") if host else None

    def know(self, topics: Iterable[str]) -> None:
        """Take further names of topics for ROS names."""
        self._roots.update(name.lstrip("/").split("/")[0] for name in topics)

    def text(self, text: str) -> str:
        """A text in which of every path the last part is left."""
        if "/" in text:
            text = _PATH.sub(self._last_part, text)
        return self._host.sub(HOST_STANDS_IN, text) if self._host else text

    def _last_part(self, match: re.Match[str]) -> str:
        path = match.group()
        root = path.lstrip("~/").split("/")[0]
        return path if root in self._roots else path.rstrip("/").rpartition("/")[2]

    def values(self, values: Mapping[str, str]) -> dict[str, str]:
        """A metadata record, without the host."""
        return {key: self.text(value) for key, value in values.items() if key != HOST}

    def attachment(self, attached: AttachedFile) -> AttachedFile:
        """A file, cleaned if it is text."""
        try:
            text = attached.data.decode()
        except UnicodeDecodeError:
            return attached
        return replace(attached, data=self.text(text).encode())

    def manifest(self, manifest: Manifest) -> Manifest:
        """A recording's manifest."""
        return Manifest(
            {name: self.values(values) for name, values in manifest.metadata.items()},
            tuple(map(self.attachment, manifest.attachments)),
        )

    def message(self, message: Message) -> Message:
        """A message whose texts are cleaned; the very same bytes if nothing was in them.

        Raises:
            BagError: it cannot be decoded.
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
    """Clean all texts of a message in place; whether that changed any."""
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
    """Write a bag without what tells where it was recorded; returns what cleaned it.

    Raises:
        BagError: the output exists, or messages cannot be decoded and hence not be cleaned.
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
