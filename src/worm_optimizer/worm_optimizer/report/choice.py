# SPDX-License-Identifier: Apache-2.0
"""Which recordings a report is of."""

from __future__ import annotations

from pathlib import Path

from worm_model.bags.bag import METADATA_FILE
from worm_model.command_line import InputError


def bags_of(path: Path) -> list[Path]:
    """A bag itself; of a folder of bags, such as a campaign's, all of them in the order in which they were closed."""
    inside = [] if (path / METADATA_FILE).exists() else list(path.glob(f"*/{METADATA_FILE}"))
    return [file.parent for file in sorted(inside, key=_closed)] or [path]


def newest_recording(folder: Path) -> Path:
    """What was recorded last in a folder: a bag, or a folder of bags such as a campaign's.

    Raises InputError if there is nothing.
    """
    found = [*folder.glob(f"*/{METADATA_FILE}"), *folder.glob(f"*/*/{METADATA_FILE}")]
    if not found:
        raise InputError(
            f"no recording in {folder.resolve()}: name one, or record one (./worm demo)"
        )
    newest = max(found, key=_closed)
    return folder / newest.relative_to(folder).parts[0]


def _closed(metadata: Path) -> tuple[float, str]:
    """When a bag was closed, and its name where two were at once."""
    return metadata.stat().st_mtime, str(metadata)
