# SPDX-License-Identifier: Apache-2.0
"""How an executable with ROS is loaded: that takes seconds, in which Ctrl-C must not be a traceback."""

from __future__ import annotations

import signal
from collections.abc import Callable
from importlib import import_module


def deferred(module: str) -> Callable[[], int | None]:
    """The ``main`` of a module that is imported once it is called.

    Until the process answers signals itself (module ros_process), SIGINT ends it without a word. As an exception it
    could come in the middle of any import, and get lost in one that catches it.
    """

    def main() -> int | None:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
        status: int | None = import_module(module).main()
        return status

    return main


def deferred_command(module: str) -> Callable[[], int | None]:
    """As deferred, of a command: once it is imported, SIGINT is the KeyboardInterrupt that it knows."""

    def main() -> int | None:
        known = signal.signal(signal.SIGINT, signal.SIG_DFL)
        command = import_module(module)
        signal.signal(signal.SIGINT, known)
        status: int | None = command.main()
        return status

    return main
