# SPDX-License-Identifier: Apache-2.0
"""Emergency stop of a robot. It persists when the driver ends, and only a deliberate reset clears it."""

import os
import re
import tempfile
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from worm_driver.simulated_clock import last_link

#: Folder shared by the service and every login shell: the state directory of worm-driver.service.
SHARED_FOLDER = Path("/var/lib/worm")

_REASON = (
    "the emergency stop is on: check the robot, then reset the stop with the service reset_emergency_stop "
    "(./worm operate emergency_stop off)"
)
_VIRTUAL = "emergency_stop_virtual"
#: If at least so many publishers are stored, `StopPublishers.note` removes those that are absent.
_MANY = 1000


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
    device = os.path.realpath(port)
    if device.startswith("/dev/pts/"):
        return (f"{_VIRTUAL}{_plain(last_link(port))}",)
    robot = _plain(" ".join((namespace.strip("/"), *map(str, sorted(servos)))))
    return f"emergency_stop_robot_{robot}", f"emergency_stop_device{_plain(device)}"


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

    def restriction(self, environment: Mapping[str, str]) -> str:
        """Return a message if only drivers of the same user find a stop of this real robot, else an empty string."""
        virtual = all(path.name.startswith(_VIRTUAL) for path in self._paths)
        home = environment.get("HOME", "/tmp")
        if virtual or self.folder == SHARED_FOLDER or not self.folder.is_relative_to(home):
            return ""
        return (
            f"emergency stops of this robot are stored in {self.folder}, where a driver of another user does not find "
            f"them; create the shared folder: sudo install -d -m 2775 -g dialout {SHARED_FOLDER}"
        )

    def adopt(self, names: Iterable[str]) -> str:
        """Load the emergency stop from the files with these names, see `latch_names`. Later calls use these files.

        If the stop is on, the missing files are created. Return a message if a file cannot be read, or if a stop cannot
        be stored in the folder, else an empty string.
        """
        self._paths = [self.folder / name for name in names]
        try:
            self.on = self._latched_here or any(path.exists() for path in self._paths)
        except OSError as error:  # a folder that this user may not read may hold a stop
            self.on = True
            return f"the emergency stop is on, as its files cannot be read: {error}"
        return self._store() if self.on else self._why_not_writable()

    def _why_not_writable(self) -> str:
        """Return why a stop could not be stored, and the next step; empty if it could."""
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=self.folder):
                return ""
        except OSError as error:
            return (
                f"an emergency stop would not be stored for the next driver ({error}): make {self.folder} writable for "
                "this user, or set WORM_STATE_DIRECTORY to a writable folder, and start the driver again"
            )

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
            return f"the emergency stop is on, but cannot be stored for the next driver: {error}"
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


@dataclass(frozen=True)
class _Last:
    """Last message of one publisher: its time of sending (ns, 0 if unknown), and its value (True: stop)."""

    sent_ns: int
    stops: bool


class StopPublishers:
    """Last message of each publisher of the emergency stop, by the publisher's identifier in the middleware."""

    def __init__(self) -> None:
        self._last: dict[bytes, _Last] = {}
        self._identified = False

    def note(
        self,
        publisher: bytes,
        sent_ns: int,
        stops: bool,  # noqa: FBT001 (the topic's own value)
        present: Collection[bytes],
    ) -> bool:
        """Store a message if it is new. Return True if it is new.

        A message is new if it was sent after the stored message of its publisher. So a message that arrives through
        several subscriptions is new only once.

        Args:
            publisher: identifier of the publisher.
            sent_ns: time of sending, ns; 0 if unknown. A message with an unknown time always counts as new.
            stops: value of the message.
            present: publishers that the ROS graph shows now.
        """
        last = self._last.get(publisher)
        if last is not None and 0 < sent_ns <= last.sent_ns:
            return False
        if len(self._last) >= _MANY:
            self.forget_absent(present)
        self._identified = self._identified or publisher in present
        self._last[publisher] = _Last(sent_ns, stops)
        return True

    def stopping(self, present: Collection[bytes]) -> set[bytes]:
        """Return the present publishers whose last message is true.

        They prevent a reset. An absent publisher does not, because it cannot publish false any more; its stop remains
        on until the reset. Some middleware identifies publishers differently in messages and in the graph. In this case
        all stored publishers count as present while the graph shows any publisher.
        """
        stopping = {publisher for publisher, last in self._last.items() if last.stops}
        if self._identified:
            return stopping & set(present)
        return stopping if present else set()

    def forget_absent(self, present: Collection[bytes]) -> int:
        """Forget the absent publishers. Return the number of those among them whose last message was true.

        If the identifiers in messages and in the graph differ (see `stopping`), all publishers count as absent while
        the graph shows no publisher, and none otherwise.
        """
        absent = set(self._last) - set(present) if self._identified or not present else set()
        return sum(self._last.pop(publisher).stops for publisher in absent)
