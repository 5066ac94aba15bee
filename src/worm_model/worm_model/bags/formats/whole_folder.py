# SPDX-License-Identifier: Apache-2.0
"""Atomic creation of a folder: it appears complete or not at all."""

from __future__ import annotations

import errno
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from worm_model.bags.formats.bag_errors import ExistsError


@contextmanager
def new_folder(target: Path) -> Iterator[Path]:
    """Yield a temporary folder that is renamed to the target when the context ends, or removed after an exception.

    Raises:
        ExistsError: The target exists, or another process has created it in the meantime.
        OSError: The operating system cannot create or write the target.
    """
    if target.exists():
        raise ExistsError(f"{target} exists already and is not overwritten; choose another name")
    unfinished = target.with_name(f".{target.name}.{os.getpid()}")
    unfinished.mkdir(parents=True)
    try:
        yield unfinished
        unfinished.rename(target)  # replaces an empty folder, and fails if the folder has content
    except OSError as error:
        if error.errno not in (errno.ENOTEMPTY, errno.EEXIST, errno.ENOTDIR):
            raise
        raise ExistsError(
            f"{target} exists already: another process has created it; choose another name"
        ) from None
    finally:
        shutil.rmtree(unfinished, ignore_errors=True)
