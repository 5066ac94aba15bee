# SPDX-License-Identifier: Apache-2.0
"""Writes raw CDR messages to a bag that survives its writer's death.

What has been synchronised is on the disk: the open chunk is closed, flushed and fsynced whenever `sync` is called, so
that ``kill -9`` or a power cut costs no more than what came since. A bag has a provisional metadata.yaml from the
start; `worm_model recover` makes a killed one whole. Nothing is ever overwritten.
"""

from __future__ import annotations

import errno
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from worm_model.bags.bag import AttachedFile
from worm_model.bags.bag_errors import ExistsError
from worm_model.bags.bag_metadata import sync_directory
from worm_model.bags.bag_writer import BagFiles, WriteOptions

STATE = "state"  # of a bag, in its custom_data
UNFINISHED, CLOSED = "being recorded", "closed"


@dataclass(frozen=True)
class Manifest:
    """What belongs to a run beside its messages; it is repeated in every file of a bag.

    Attributes:
        metadata: MCAP metadata records by name, each of text by key.
        attachments: files kept in the bag.
    """

    metadata: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    attachments: tuple[AttachedFile, ...] = ()


class BagRecorder(BagFiles):
    """One bag in the making. Not thread-safe: one thread writes.

    Args:
        directory: the bag, a directory that must not exist.
        manifest: what goes into every file of the bag.
        options: how to write.

    Raises:
        ExistsError: the directory exists.
        OSError: it cannot be made or written.
    """

    def __init__(self, directory: Path, manifest: Manifest, options: WriteOptions) -> None:
        try:
            directory.mkdir(parents=True)
        except FileExistsError:
            raise ExistsError(
                f"{directory} exists already and is not overwritten; choose another name"
            ) from None
        super().__init__(directory, directory.name, options, {STATE: UNFINISHED})
        for name, values in manifest.metadata.items():
            self.add_metadata(name, values)
        for attached in manifest.attachments:
            self.add_attachment(attached)
        super().sync()
        self.describe()
        sync_directory(directory.parent)

    def sync(self) -> None:
        """Bring all messages to the disk.

        Raises:
            FileNotFoundError: somebody has removed the bag, and what was in it is lost.
            OSError: the disk is full or gone.
        """
        super().sync()
        if not self._file.is_there:
            raise FileNotFoundError(
                errno.ENOENT, "it was removed while it was recorded", str(self.directory)
            )

    def close(self) -> None:
        """Finish the bag: index, summary and the final metadata.yaml.

        Raises:
            OSError: the disk is full or gone; the bag then wants `worm_model recover`.
        """
        self.custom = {STATE: CLOSED}
        self.sync()
        self.finish()
