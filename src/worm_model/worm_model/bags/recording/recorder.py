# SPDX-License-Identifier: Apache-2.0
"""Bag that is being recorded. It stays readable if the recorder is killed.

Each call of `sync` closes, flushes and fsyncs the open chunk. ``kill -9`` or a power cut then loses only the messages
since the last call. A bag has a provisional metadata.yaml from the start. Nothing is ever overwritten.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from worm_model.bags.formats.bag_errors import ExistsError
from worm_model.bags.formats.bag_metadata import CLOSED, STATE, UNFINISHED, sync_directory
from worm_model.bags.formats.bag_writer import BagWriter
from worm_model.bags.formats.message_block import Message
from worm_model.bags.formats.stored_file import AttachedFile

SYNC_S = 0.5  # longest time between synchronisations of a bag


@dataclass(frozen=True)
class Manifest:
    """Data of a run in addition to its messages.

    Attributes:
        metadata: MCAP metadata records by name, each with text by key.
        attachments: files stored in the bag.
    """

    metadata: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    attachments: tuple[AttachedFile, ...] = ()


class BagRecorder(BagWriter):
    """Bag that is being recorded.

    Args:
        directory: the bag, a directory that must not exist.
        manifest: data of the run.
    """

    def __init__(self, directory: Path, manifest: Manifest) -> None:
        try:
            directory.mkdir(parents=True)
        except FileExistsError:
            raise ExistsError(
                f"{directory} exists already and is not overwritten; choose another name"
            ) from None
        self._due = 0.0
        super().__init__(directory, directory.name, {STATE: UNFINISHED})
        for name, values in manifest.metadata.items():
            self.add_metadata(name, values)
        for attached in manifest.attachments:
            self.add_attachment(attached)
        self.sync()
        self.describe()
        sync_directory(directory.parent)

    def record(self, messages: Sequence[Message]) -> None:
        """Append messages, and synchronise the bag if the last synchronisation was SYNC_S ago."""
        self.write_all(messages)
        if time.monotonic() >= self._due:
            self.sync()
            self._due = time.monotonic() + SYNC_S

    def close(self) -> None:
        """Finish the bag: index, summary and the final metadata.yaml."""
        self.custom = {STATE: CLOSED}
        self.sync()
        self.finish()
