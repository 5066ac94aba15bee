# SPDX-License-Identifier: Apache-2.0
"""The emergency stop, which outlasts the driver: while it is on, nothing starts."""

import os
import re
from collections.abc import Mapping
from pathlib import Path

_REASON = (
    "the emergency stop is on: see to the robot, then say false on the topic emergency_stop "
    "(./worm operate emergency_stop off)"
)


def state_folder(environment: Mapping[str, str]) -> Path:
    """Where a program keeps what outlasts it: as systemd says, else as the XDG base directories do."""
    if "STATE_DIRECTORY" in environment:
        return Path(environment["STATE_DIRECTORY"].split(os.pathsep)[0])
    base = environment.get("XDG_STATE_HOME") or Path(
        environment.get("HOME", "/tmp"), ".local/state"
    )
    return Path(base, "worm_driver")


class EmergencyLatch:
    """Whether the emergency stop of a robot is on; a file in a folder tells the next driver. One thread sets it."""

    def __init__(self, folder: Path):
        self._folder = folder
        self._path: Path | None = None
        self.on = False

    def adopt(self, port: str) -> str:
        """Goes on with the robot at a port, as it was left; returns what failed on the way, in words."""
        name = re.sub(r"[^\w.]+", "_", port)
        self._path = self._folder / f"emergency_stop{name}"
        self.on = self.on or self._path.exists()
        return self.set(self.on)

    def set(self, on: bool) -> str:  # noqa: FBT001 (the topic's own value)
        """Turns it on or off; returns what failed on the way, in words: it is set all the same."""
        self.on = on
        try:
            self._keep()
        except OSError as error:
            return f"the emergency stop is {'on' if on else 'off'}, but the next driver will not know: {error}"
        return ""

    def why_not_start(self) -> str:
        """Why nothing may start; empty when it may."""
        return _REASON if self.on else ""

    def _keep(self) -> None:
        if self._path is None:
            return
        if self.on:
            self._folder.mkdir(parents=True, exist_ok=True)
            self._path.touch()
        else:
            self._path.unlink(missing_ok=True)
