# SPDX-License-Identifier: Apache-2.0
"""Emergency stop of a robot. It persists when the driver ends, and only a deliberate reset clears it."""

import os
import re
from collections.abc import Iterable, Mapping
from pathlib import Path

from worm_driver.simulated_clock import is_virtual, last_link

#: Folder shared by the service and every login shell: the state directory of worm-driver.service.
SHARED_FOLDER = Path("/var/lib/worm")

_REASON = (
    "the emergency stop is on: check the robot, then reset the stop with the service reset_emergency_stop "
    "(./worm operate emergency_stop off)"
)
_VIRTUAL = "emergency_stop_virtual"


def state_folder(environment: Mapping[str, str], shared: Path = SHARED_FOLDER) -> Path:
    """Return the folder in which an emergency stop is stored.

    The environment variable WORM_STATE_DIRECTORY names the folder, or else systemd's STATE_DIRECTORY. If neither is
    set, the folder is ``shared`` if this folder exists, otherwise a folder of the user (XDG base directories).
    """
    for variable in ("WORM_STATE_DIRECTORY", "STATE_DIRECTORY"):
        if environment.get(variable):
            return Path(environment[variable].split(os.pathsep)[0])
    if shared.is_dir():
        return shared
    base = environment.get("XDG_STATE_HOME") or Path(
        environment.get("HOME", "/tmp"), ".local/state"
    )
    return Path(base, "worm_driver")


def latch_names(namespace: str, servos: Iterable[int], port: str) -> tuple[str, ...]:
    """Return the file names of a robot's emergency stop: one for the robot, one for its device.

    A stop is on if either file exists, so neither another name of the port nor another namespace evades it.

    A virtual robot has only one file. The file is named after the link to the robot's pseudo-terminal, the last one if
    ``port`` leads through several links. The number of the pseudo-terminal does not identify the robot, because Linux
    reuses the numbers. The namespace does not identify it either, because a virtual robot in another ROS domain may
    have the same namespace.

    Args:
        namespace: namespace of the driver.
        servos: ids of all servos.
        port: path of the serial port.
    """
    if is_virtual(port):
        return (f"{_VIRTUAL}{_plain(last_link(port))}",)
    robot = _plain(" ".join((namespace.strip("/"), *map(str, sorted(servos)))))
    return f"emergency_stop_robot_{robot}", f"emergency_stop_device{_plain(os.path.realpath(port))}"


def _plain(text: str) -> str:
    return re.sub(r"[^\w.]+", "_", text)


class EmergencyLatch:
    """Emergency stop of a robot, stored in files of a folder for the next driver. Only one thread may change it.

    Attributes:
        folder: folder of the files.
        on: True while the emergency stop is on.
    """

    def __init__(self, folder: Path):
        self.folder = folder
        self._paths: list[Path] = []
        self._latched_here = False
        self.on = False

    def adopt(self, names: Iterable[str]) -> str:
        """Load the emergency stop from the files with these names, see `latch_names`. Later calls use these files.

        If the stop is on, the missing files are created. Return a message if a file cannot be read or the stop cannot
        be stored, else an empty string.
        """
        self._paths = [self.folder / name for name in names]
        try:
            self.on = self._latched_here or any(path.exists() for path in self._paths)
        except OSError as error:  # a folder that this user may not read may hold a stop
            self.on = True
            return f"the emergency stop is on, as its files cannot be read: {error}"
        return self._store() if self.on else ""

    def latch(self) -> str:
        """Turn the stop on. Return a message if the stop is on but could not be stored, else an empty string."""
        self.on = self._latched_here = True
        return self._store()

    def _store(self) -> str:
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            for path in self._paths:
                if not path.exists():  # the file may belong to another user
                    path.touch()
        except OSError as error:
            return (
                f"the emergency stop is on, but cannot be stored for the next driver ({error}): make {self.folder} "
                "writable for this user, or set WORM_STATE_DIRECTORY to a writable folder"
            )
        return ""

    def reset(self) -> str:
        """Turn the stop off. Return a message if it stays on because a file cannot be removed, else an empty string."""
        try:
            for path in self._paths:
                path.unlink(missing_ok=True)
        except OSError as error:
            return f"the emergency stop stays on, as its file cannot be removed: {error}"
        self.on = self._latched_here = False
        return ""

    def why_not_start(self) -> str:
        """Return the reason why the torque must not be enabled and no run may start; empty if both are permitted."""
        return _REASON if self.on else ""
