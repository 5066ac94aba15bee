# SPDX-License-Identifier: Apache-2.0
"""Open file of a bag, whatever its format."""

from __future__ import annotations

import fcntl
import mmap
import shutil
import sqlite3
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import NamedTemporaryFile, gettempdir
from typing import BinaryIO, cast

import zstandard
from zstandard import ZstdDecompressor

from worm_model.bags.formats.bag_errors import RECOVER, BagError
from worm_model.bags.formats.contents import AttachedFile, Contents, Extent
from worm_model.bags.formats.finding import COMPRESSED, check_readable
from worm_model.bags.formats.mcap_records import DAMAGE
from worm_model.bags.formats.message_block import Messages, Topic

# largest ratio of the decompressed size of a file to its compressed size; that of a recording is about 10
LARGEST_RATIO = 1000
# latest supported time, ns since the epoch (year 2262): the largest signed number of 64 bits
LATEST_NS = (1 << 63) - 1


@contextmanager
def explained(path: Path) -> Iterator[None]:
    """Convert the exceptions that readers raise for damaged content to a BagError."""
    try:
        yield
    except BagError:
        raise
    except (*DAMAGE, sqlite3.Error) as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise BagError(
            f"{path} is damaged ({reason}); save its intact part with: {RECOVER} {path}"
        ) from None


class StoredFile(ABC):
    """File with messages that is open for reading.

    Args:
        path: the file.

    Attributes:
        data: bytes of the file, decompressed.
        contents: what the file contains besides the messages: topics, their counts, and places of messages and damage.

    Raises:
        BagError: The file is missing or empty, or cannot be read.
    """

    contents: Contents

    def __init__(self, path: Path) -> None:
        self.path = path
        check_readable(path)
        try:
            self._stream = _unpacked(path) if path.suffix == COMPRESSED else path.open("rb")
            self._map = mmap.mmap(self._stream.fileno(), 0, access=mmap.ACCESS_READ)
        except BagError:
            raise
        except ValueError:
            self._stream.close()
            raise BagError(f"{path} is empty: nothing was recorded, or its disk was full") from None
        except OSError as error:
            raise BagError(f"{path} cannot be read: {error.strerror}") from None
        self.data = memoryview(self._map)
        try:
            with explained(path):
                self.contents = self._survey()
        except BagError:
            self.close()
            raise

    @abstractmethod
    def _survey(self) -> Contents:
        """Return what the file contains besides the messages, see `contents`."""

    @property
    @abstractmethod
    def channels(self) -> Mapping[int, Topic]:
        """Topics by channel number. Their field ``count`` (number of messages) is not set."""

    @abstractmethod
    def blocks(
        self, extents: Iterable[Extent], topics: frozenset[str]
    ) -> Iterator[tuple[int, Messages]]:
        """Yield (start in ns, block) for the messages of some topics in some extents.

        ``extents`` are in order of start. No message of a block has a log time before the start of the block.
        """

    def attachments(self) -> Iterator[AttachedFile]:
        """Yield the attached files."""
        return iter(())

    def close(self) -> None:
        """Close the file; arrays that were read from it stay valid."""
        with suppress(BufferError):  # while arrays refer to the map, it stays open
            self.data.release()
            self._map.close()
        self._stream.close()

    def is_being_written(self) -> bool:
        """Return True if a recorder has the file open at this moment."""
        try:
            fcntl.flock(self._stream, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except OSError:
            return True
        fcntl.flock(self._stream, fcntl.LOCK_UN)
        return False


def _unpacked(path: Path) -> BinaryIO:
    """Return the content of a file that rosbag2 has compressed, up to the first damage, in a temporary file.

    Raises:
        BagError: The content is larger than LARGEST_RATIO times the file, or larger than half of the free space for
            temporary files (the other half stays free for other processes), or a file that is not empty has no
            content before its first damage.
    """
    free = shutil.disk_usage(gettempdir()).free // 2
    most, size = min(free, LARGEST_RATIO * path.stat().st_size), 0
    unpacked = cast(BinaryIO, NamedTemporaryFile())  # noqa: SIM115 - the caller closes it
    with path.open("rb") as packed, suppress(zstandard.ZstdError):
        for piece in ZstdDecompressor().read_to_iter(packed):
            size += len(piece)
            if size > most:
                unpacked.close()
                limit = (
                    f"half of the free space in {gettempdir()}; set TMPDIR to a folder with more"
                    if most == free
                    else f"{LARGEST_RATIO} times its size; it is damaged or was not written by a recorder"
                )
                raise BagError(f"{path} decompresses to more than {most} bytes, {limit}")
            unpacked.write(piece)
    if not size and path.stat().st_size:
        unpacked.close()
        raise BagError(
            f"{path} decompresses to nothing: it is damaged from its beginning, or nothing was recorded"
        )
    unpacked.flush()
    return unpacked
