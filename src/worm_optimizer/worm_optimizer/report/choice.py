# SPDX-License-Identifier: Apache-2.0
"""Which recordings a report is of."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from worm_model.bags.bag import METADATA_FILE
from worm_model.bags.bag_errors import BagError
from worm_model.bags.opening import open_bag
from worm_model.bags.run_reader import read_run
from worm_model.commands.command_line import InputError


def bags_of(path: Path) -> list[Path]:
    """A bag itself; of a folder of bags, such as a campaign's, all of them in the order in which they were closed."""
    inside = [] if (path / METADATA_FILE).exists() else list(path.glob(f"*/{METADATA_FILE}"))
    return [file.parent for file in sorted(inside, key=_closed)] or [path]


def newest_recording(folder: Path, notify: Callable[[str], None]) -> Path:
    """What was recorded last in a folder: a bag, or a folder of bags such as a campaign's, in which a gait was run.

    ``notify`` is told of what is passed over. Raises InputError if there is nothing.
    """
    found = [*folder.glob(f"*/{METADATA_FILE}"), *folder.glob(f"*/*/{METADATA_FILE}")]
    for metadata in sorted(found, key=_closed, reverse=True):
        if _holds_gait(metadata.parent, notify):
            return folder / metadata.relative_to(folder).parts[0]
    raise InputError(
        f"no recording of a gait in {folder.resolve()}: name one, or record one (./worm demo)"
    )


def _holds_gait(path: Path, notify: Callable[[str], None]) -> bool:
    try:
        with open_bag(path, notify) as bag:
            states = read_run(bag, names=("gait_state",)).gait_state
    except BagError as error:
        notify(f"passed over: {error}")
        return False
    played = bool(states.played.any())
    if not played:
        notify(f"passed over: in {path} no gait was run")
    return played


def _closed(metadata: Path) -> tuple[float, str]:
    """When a bag was closed, and its name where two were at once."""
    return metadata.stat().st_mtime, str(metadata)
