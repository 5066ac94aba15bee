# SPDX-License-Identifier: Apache-2.0
"""Deferred imports of executables that use ROS.

Such an import takes up to a second. ``--help`` of a node does without it, and Ctrl-C during the import prints no
traceback.
"""

from __future__ import annotations

import argparse
import signal
import sys
from collections.abc import Callable, Sequence
from importlib import import_module

from worm_msgs.command_parser import Parser


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


def node(name: str, description: str, rows: str, module: str) -> Callable[..., int]:
    """Return the ``main`` of a node, which accepts only ``--help`` and ROS arguments.

    Args:
        name: name of the executable.
        description: description for ``--help``.
        rows: module whose function ``rows`` returns the descriptions of the node's parameters, for ``--help``.
        module: module whose function ``run`` creates and serves the node, see `worm_msgs.node_command.run_node`. Its
            tuple ``REJECTIONS`` has the exceptions that ``run`` raises on bad input.
    """

    def main(arguments: Sequence[str] | None = None) -> int:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
        command_line = list(sys.argv if arguments is None else arguments)
        parser = _NodeParser(name, description, rows)
        if {"-h", "--help"} & {*command_line}:
            parser.parse_args(["--help"])
        status: int = import_module("worm_msgs.node_command").run_node(
            parser, import_module(module), command_line
        )
        return status

    return main


class _NodeParser(Parser):
    """Parser whose only option is --help."""

    def __init__(self, name: str, description: str, rows: str) -> None:
        table = "\n".join(
            f"  {row.name}  (default {row.default!r})\n      {row.description}"
            for row in import_module(rows).rows()
        )
        super().__init__(
            prog=name,
            description=description,
            usage=f"{name} [--help] [--ros-args [-p PARAMETER:=VALUE] [--params-file FILE] [-r FROM:=TO] ...]",
            epilog=f"parameters:\n{table}",
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )


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
