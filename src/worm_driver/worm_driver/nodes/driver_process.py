# SPDX-License-Identifier: Apache-2.0
"""How a process with ROS begins and ends: the only place that calls rclpy.init."""

import contextlib
import gc
import os
import signal
from collections.abc import Callable, Iterator, Sequence
from types import FrameType

import rclpy
from rclpy.signals import SignalHandlerOptions

_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class Ending:
    """Whether a process was asked to end: call it.

    Attributes:
        again: called by every SIGINT after the first signal, in its handler: an impatient person's. SIGTERM is how
            launch and systemd escalate by themselves.
    """

    def __init__(self) -> None:
        self.again: Callable[[], None] = lambda: None
        self._asked = False

    def __call__(self) -> bool:
        """Whether it was asked to end."""
        return self._asked

    def on_signal(self, number: int, _: FrameType | None) -> None:
        """The handler."""
        if self._asked and number == signal.SIGINT:
            self.again()
        self._asked = True


@contextlib.contextmanager
def ros_process(arguments: Sequence[str] | None = None) -> Iterator[Ending]:
    """ROS while this lasts; SIGINT, SIGTERM and SIGHUP set a flag and do nothing else.

    rclpy's own handlers would take the context away from under a node that still has something to do or to say.
    Discovery stays on this machine unless the environment says otherwise (security/README.md).

    Args:
        arguments: the command line with the program's name; None for that of the process.
    """
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    ending = Ending()
    rclpy.init(
        args=None if arguments is None else list(arguments),
        signal_handler_options=SignalHandlerOptions.NO,
    )
    before = {number: signal.signal(number, ending.on_signal) for number in _SIGNALS}
    try:
        yield ending
    finally:
        rclpy.try_shutdown()
        for number, handler in before.items():
            # A process that was asked ends now: another Ctrl-C must not turn that into a failure.
            signal.signal(number, signal.SIG_IGN if ending() else handler)


def spare_pauses() -> None:
    """Exempt all objects that there are now from garbage collection, to be called once a node is built.

    A collection that goes through the modules and ROS stops every thread for tens of ms, the one of the servo bus, too.
    """
    gc.collect()
    gc.freeze()
