# SPDX-License-Identifier: Apache-2.0
"""Deferred imports of executables that use ROS.

Such an import takes seconds. Ctrl-C during the import must not print a traceback.
"""

from __future__ import annotations

import signal
from collections.abc import Callable
from importlib import import_module


def deferred(module: str) -> Callable[[], int | None]:
    """Return a function that imports a module and calls its ``main``.

    Until `ros_process` sets its signal handlers, SIGINT ends the process without a traceback. KeyboardInterrupt would
    be unreliable during the import, because an imported module may catch it.
    """

    def main() -> int | None:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
        status: int | None = import_module(module).main()
        return status

    return main


def deferred_command(module: str) -> Callable[[], int | None]:
    """Return a function that imports the module of a command and calls its ``main``, see `deferred`.

    After the import, SIGINT raises KeyboardInterrupt again.
    """

    def main() -> int | None:
        previous = signal.signal(signal.SIGINT, signal.SIG_DFL)
        command = import_module(module)
        signal.signal(signal.SIGINT, previous)
        status: int | None = command.main()
        return status

    return main
