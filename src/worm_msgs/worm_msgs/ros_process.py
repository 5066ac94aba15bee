# SPDX-License-Identifier: Apache-2.0
"""How a process with ROS begins and ends, the same for every executable: the only place that calls rclpy.init."""

from __future__ import annotations

import contextlib
import gc
import os
import re
import signal
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from types import FrameType

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args

from worm_msgs import network

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
#: s, after a signal nothing happens for at most so long
SPIN_S = 0.1
#: s, in which further signals are the same Ctrl-C: a terminal and launch may both pass it on
_SAME_PRESS_S = 1.5
#: how rcl's message begins when the environment allows no node: security that this middleware has not, no network
_NO_NODE = "error creating node"


class ShutdownRequest:
    """Whether a process was asked to end: call it.

    Attributes:
        first: called by the first signal, in its handler: what ends then is ordered before all that comes later.
        again: called by every later SIGINT, in its handler: an impatient person's. SIGTERM is how launch and
            systemd escalate by themselves.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self.first: Callable[[], None] = lambda: None
        self.again: Callable[[], None] = lambda: None
        self._clock = clock
        self._first: float | None = None

    def __call__(self) -> bool:
        """Whether it was asked to end."""
        return self._first is not None

    def on_signal(self, number: int, _: FrameType | None) -> None:
        """The handler."""
        now = self._clock()
        if self._first is None:
            self._first = now
            self.first()
        elif number == signal.SIGINT and now - self._first > _SAME_PRESS_S:
            self.again()


@contextlib.contextmanager
def ros_process(arguments: Sequence[str] | None = None) -> Iterator[ShutdownRequest]:
    """ROS while this lasts; SIGINT, SIGTERM and SIGHUP set a flag and do nothing else.

    rclpy's own handlers would take the context away from under a node that still has something to do or to say. The
    process is heard on this machine only, unless the environment says otherwise, which is told (module network).

    Args:
        arguments: the command line with the program's name; None for that of the process.

    Raises:
        SystemExit: the middleware cannot be kept on this machine, or a ROS argument or what the environment asks of
            ROS cannot be had; the reason is on standard error.
    """
    try:
        heard = network.bind(os.environ, rclpy.get_rmw_implementation_identifier())
    except network.NetworkError as error:
        _say(str(error))
        raise SystemExit(2) from error
    if not heard.is_local:
        _say(str(heard))
    ending = ShutdownRequest()
    try:
        rclpy.init(
            args=None if arguments is None else list(arguments),
            signal_handler_options=SignalHandlerOptions.NO,
        )
    except RuntimeError as error:  # of rcl, whose classes have no public name
        raise _refuse(error) from None
    before = {number: signal.signal(number, ending.on_signal) for number in SIGNALS}
    try:
        yield ending
    except RuntimeError as error:  # as above
        if not str(error).startswith(_NO_NODE):
            raise
        raise _refuse(error) from None
    finally:
        rclpy.try_shutdown()
        for number, handler in before.items():
            # A process that was asked ends now: another Ctrl-C must not turn that into a failure.
            signal.signal(number, signal.SIG_IGN if ending() else handler)


@contextlib.contextmanager
def exiting_on_signal() -> Iterator[None]:
    """Within ros_process, while this lasts: a signal ends the process where it is, as there is nothing to do before."""
    before = {number: signal.signal(number, signal.SIG_DFL) for number in SIGNALS}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def own_arguments(arguments: Sequence[str]) -> list[str]:
    """A command line without its ROS arguments.

    Raises:
        SystemExit: one of them cannot be used, such as a file of parameters; the reason is on standard error.
    """
    try:
        return list(remove_ros_args(list(arguments)))
    except RuntimeError as error:  # as above
        raise _refuse(error) from None


def one_line_of(error: Exception) -> str:
    """A message of rcl in one line, without the places in its source."""
    return " ".join(re.sub(r",? at [./]\S+:\d+", "", str(error)).split())


def _refuse(error: Exception) -> SystemExit:
    print(f"ROS: {one_line_of(error)}", file=sys.stderr)  # noqa: T201 (what every process says)
    return SystemExit(2)


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
