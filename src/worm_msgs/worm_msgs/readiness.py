# SPDX-License-Identifier: Apache-2.0
"""Report of a node to its parent process that it is ready, in the protocol of systemd, sd_notify(3).

Unlike a query of the ROS graph, the report needs no discovery and cannot confuse nodes of the same name.
"""

from __future__ import annotations

import contextlib
import os
import socket

_VARIABLE = "NOTIFY_SOCKET"
_MESSAGE = b"READY=1"
_ABSTRACT = "@"  # stands for the zero byte at the start of an abstract address


def announce() -> None:
    """Report that this process is ready. Do nothing if the parent process does not listen."""
    address = os.environ.get(_VARIABLE)
    if not address:
        return
    if address.startswith(_ABSTRACT):
        address = "\0" + address[1:]
    with (
        socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sender,
        contextlib.suppress(
            OSError
        ),  # The parent no longer listens, for example to a restarted node.
    ):
        sender.sendto(_MESSAGE, address)


class Readiness:
    """Receiver of the report of one process.

    Attributes:
        environment: variables to add to the environment of the process that reports.
    """

    def __init__(self) -> None:
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK)
        self._socket.bind("")  # the kernel chooses a free address: autobind, unix(7)
        name = self._socket.getsockname()[1:].decode()
        self.environment = {_VARIABLE: _ABSTRACT + name}
        self._received = False

    def __call__(self) -> bool:
        """Return True if the report has arrived."""
        with contextlib.suppress(BlockingIOError):
            while not self._received:
                self._received = self._socket.recv(4096) == _MESSAGE
        return self._received

    def fileno(self) -> int:
        """Return the file descriptor of the socket. It becomes readable when a report arrives."""
        return self._socket.fileno()

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()
