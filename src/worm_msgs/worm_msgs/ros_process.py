# SPDX-License-Identifier: Apache-2.0
"""How a process with ROS begins and ends, the same for every executable: the only place that calls rclpy.init."""

from __future__ import annotations

import contextlib
import gc
import os
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from types import FrameType

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from worm_msgs import network

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
#: s, after a signal nothing happens for at most so long
SPIN_S = 0.1


class Ending:
    """Whether a process was asked to end: call it.

    Attributes:
        again: called by every signal after the first one, in the signal's handler.
    """

    def __init__(self) -> None:
        self.again: Callable[[], None] = lambda: None
        self._asked = False

    def __call__(self) -> bool:
        """Whether it was asked to end."""
        return self._asked

    def on_signal(self, _: int, __: FrameType | None) -> None:
        """The handler."""
        if self._asked:
            self.again()
        self._asked = True


@contextlib.contextmanager
def ros_process(arguments: Sequence[str] | None = None) -> Iterator[Ending]:
    """ROS while this lasts; SIGINT, SIGTERM and SIGHUP set a flag and do nothing else.

    rclpy's own handlers would take the context away from under a node that still has something to do or to say. The
    process is heard on this machine only, unless the environment says otherwise, which is told (module network).

    Args:
        arguments: the command line with the program's name; None for that of the process.

    Raises:
        SystemExit: the middleware cannot be kept on this machine; the reason is on standard error.
    """
    try:
        heard = network.bind(os.environ, rclpy.get_rmw_implementation_identifier())
    except network.NetworkError as error:
        _say(str(error))
        raise SystemExit(2) from error
    if not heard.is_local:
        _say(str(heard))
    ending = Ending()
    rclpy.init(
        args=None if arguments is None else list(arguments),
        signal_handler_options=SignalHandlerOptions.NO,
    )
    before = {number: signal.signal(number, ending.on_signal) for number in SIGNALS}
    try:
        yield ending
    finally:
        rclpy.try_shutdown()
        for number, handler in before.items():
            # A process that was asked ends now: another Ctrl-C must not turn that into a failure.
            signal.signal(number, signal.SIG_IGN if ending() else handler)


def spare_pauses() -> None:
    """Exempts all objects that there are now from garbage collection, to be called once a node is built.

    A collection through the modules, the compiled kernel and ROS takes some 60 ms, in which every thread stands.
    """
    gc.collect()
    gc.freeze()


def spin(node: Node, ended: Callable[[], bool]) -> None:
    """Serves a node until the process is asked to end."""
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    spare_pauses()
    while not ended():
        executor.spin_once(timeout_sec=SPIN_S)
    executor.shutdown()


def _say(text: str) -> None:
    print(f"network: {text}", file=sys.stderr)  # noqa: T201 (what every process says)
