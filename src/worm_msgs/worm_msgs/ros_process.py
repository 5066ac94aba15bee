# SPDX-License-Identifier: Apache-2.0
"""Start and end of the process of a node. Only this module calls rclpy.init.

The commands start, operate, console, demo and campaign do not use `ros_process`. Their ROS context is that of
`worm_optimizer.nodes.operator_node.operator`.
"""

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
from rclpy.callback_groups import CallbackGroup
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args

from worm_msgs import network

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
#: s, longest wait for a callback in `spin`. A signal takes effect after this wait, or after the running callback
SPIN_S = 0.1
#: s, time after the first signal in which a SIGINT belongs to the same Ctrl-C, because both the terminal and launch may
#: send SIGINT
_SAME_PRESS_S = 1.5
#: Start of rcl's message if no node can be created, for example because the middleware lacks security.
_NO_NODE = "error creating node"


class ShutdownRequest:
    """Request to end the process, made by a signal.

    Args:
        clock: returns the time, s, monotonic.

    Attributes:
        first: called in the handler of the first signal, before the main thread can poll the request again.
        again: called in the handler of every SIGINT more than 1.5 s after the first signal (a second Ctrl-C of the
            operator). Later SIGTERMs do not count, because launch and systemd send them to escalate.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self.first: Callable[[], None] = lambda: None
        self.again: Callable[[], None] = lambda: None
        self._clock = clock
        self._first: float | None = None

    def __call__(self) -> bool:
        """Return True if a signal has arrived."""
        return self._first is not None

    @contextlib.contextmanager
    def interrupting(self) -> Iterator[None]:
        """Raise `KeyboardInterrupt` at the first signal, during a long computation of the main thread.

        The computation must have no effect other than its result, because it ends at any point.
        """

        def interrupt() -> None:
            raise KeyboardInterrupt

        before, self.first = self.first, interrupt
        try:
            if self():
                raise KeyboardInterrupt
            yield
        finally:
            self.first = before

    def on_signal(self, number: int, _: FrameType | None) -> None:
        """Store the request and call `first` or `again`, as a handler of signals."""
        now = self._clock()
        if self._first is None:
            self._first = now
            self.first()
        elif number == signal.SIGINT and now - self._first > _SAME_PRESS_S:
            self.again()


@contextlib.contextmanager
def ros_process(arguments: Sequence[str] | None = None) -> Iterator[ShutdownRequest]:
    """Initialise ROS for the duration of the context. SIGINT, SIGTERM and SIGHUP then go to the yielded request.

    rclpy's own handlers would shut down rclpy's context while a node still works. Only this machine can reach the
    process, unless the environment opens the network (module `network`). A line on standard error reports an open
    network.

    Args:
        arguments: command line with the program's name; None: the command line of the process.

    Raises:
        SystemExit: The middleware cannot be bound to this machine, ROS rejects an argument or the environment, or ROS
            cannot create a node within the context. The reason is on standard error.
    """
    try:
        reach = network.bind(os.environ, rclpy.get_rmw_implementation_identifier())
    except network.NetworkError as error:
        _print_network(str(error))
        raise SystemExit(2) from error
    if not reach.is_local:
        _print_network(str(reach))
    ending = ShutdownRequest()
    try:
        rclpy.init(
            args=None if arguments is None else list(arguments),
            signal_handler_options=SignalHandlerOptions.NO,
        )
    except RuntimeError as error:  # from rcl, whose exceptions have no public name
        raise _exit(error) from None
    before = {number: signal.signal(number, ending.on_signal) for number in SIGNALS}
    try:
        yield ending
    except RuntimeError as error:  # from rcl
        if not str(error).startswith(_NO_NODE):
            raise
        raise _exit(error) from None
    finally:
        rclpy.try_shutdown()
        for number, handler in before.items():
            # After a request the process ends now. Another Ctrl-C must not turn this end into a failure.
            signal.signal(number, signal.SIG_IGN if ending() else handler)


@contextlib.contextmanager
def exiting_on_signal() -> Iterator[None]:
    """Let signals end the process at once, for a part of `ros_process` that needs no clean-up."""
    before = {number: signal.signal(number, signal.SIG_DFL) for number in SIGNALS}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def own_arguments(arguments: Sequence[str]) -> list[str]:
    """Return a command line without its ROS arguments."""
    try:
        return list(remove_ros_args(list(arguments)))
    except RuntimeError as error:  # from rcl
        raise _exit(error) from None


def one_line_of(error: Exception) -> str:
    """Return a message of rcl in one line, without positions in the source code of rcl."""
    return " ".join(re.sub(r",? at [./]\S+:\d+", "", str(error)).split())


def _exit(error: Exception) -> SystemExit:
    print(f"ROS: {one_line_of(error)}", file=sys.stderr)  # noqa: T201 (output of every process)
    return SystemExit(2)


def freeze_garbage_collection() -> None:
    """Exempt all present objects from garbage collection. Call this when the node is complete.

    A collection that visits all objects of the modules, the compiled kernel and ROS takes about 60 ms. It blocks every
    thread.
    """
    gc.collect()
    gc.freeze()


def spin(node: Node, ended: Callable[[], bool]) -> None:
    """Execute the callbacks of a node until ``ended`` returns True."""
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    freeze_garbage_collection()
    while not ended():
        executor.spin_once(timeout_sec=SPIN_S)
    executor.shutdown()


class PolledGroup(CallbackGroup):
    """Callback group of subscriptions that the node polls. The executor must not read them."""

    def can_execute(self, _: object) -> bool:
        """Return False."""
        return False

    def beginning_execution(self, _: object) -> bool:
        """Return False."""
        return False

    def ending_execution(self, _: object) -> None:
        """Do nothing."""


def _print_network(text: str) -> None:
    print(f"network: {text}", file=sys.stderr)  # noqa: T201 (output of every process)
