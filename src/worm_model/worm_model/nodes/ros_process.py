# SPDX-License-Identifier: Apache-2.0
"""How an executable with ROS begins and ends."""

from __future__ import annotations

import gc
import os
import signal
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from types import FrameType

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
SPIN_S = 0.1  # after a signal, at most this long nothing happens


@contextmanager
def ros_process(arguments: Sequence[str] | None = None) -> Iterator[Callable[[], bool]]:
    """ROS while this lasts; yields what tells whether the process was asked to end.

    A signal only sets a flag: rclpy's own handlers would take the context away from under a node that
    still works. Discovery stays on this machine unless the environment says otherwise.

    Args:
        arguments: of the command line with the program's name, default: those of the process.
    """
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    rclpy.init(
        args=None if arguments is None else list(arguments),
        signal_handler_options=SignalHandlerOptions.NO,
    )
    asked = False

    def ask(_: int, __: FrameType | None) -> None:
        nonlocal asked
        asked = True

    before = {number: signal.signal(number, ask) for number in SIGNALS}
    try:
        yield lambda: asked
    finally:
        rclpy.try_shutdown()
        for number, handler in before.items():
            # A process that was asked ends now: another Ctrl-C must not turn that into a failure.
            signal.signal(number, signal.SIG_IGN if asked else handler)


def spare_pauses() -> None:
    """Exempt all objects that there are now from garbage collection, to be called once a node is built.

    A collection that goes through the modules, the compiled kernel and ROS takes some 60 ms, in which a node stands.
    """
    gc.collect()
    gc.freeze()


def spin(node: Node, ended: Callable[[], bool]) -> None:
    """Serve a node until the process is asked to end."""
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    spare_pauses()
    while not ended():
        executor.spin_once(timeout_sec=SPIN_S)
    executor.shutdown()
