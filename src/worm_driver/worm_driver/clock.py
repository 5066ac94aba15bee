# SPDX-License-Identifier: Apache-2.0
"""The clock that the threads of a robot go by, and wait on: the machine's, or that of a virtual robot.

On a virtual robot the time is the robot's own, and it passes only while every thread that works with the robot waits
for something (virtual_robot/wire/virtual_clock.py). Whoever waits by one of these, and nowhere else, is not hurried
by a machine that is slow or has something else to do.
"""

import select
import time
from dataclasses import dataclass
from typing import Protocol


@dataclass
class Traffic:
    """Bytes that a serial line has carried since it was opened, as counted by who opened it."""

    written: int = 0
    read: int = 0


class Clock(Protocol):
    """What a thread goes by; calling it gives the time (s, monotonic).

    Attributes:
        traffic: of the serial line that the thread owns, to be kept up to date by it.
        epoch_ns: ns, the ROS time of the clock's zero; None where the two may be set against each other.
        patience: s, which a call to another thread is waited for at least: time that the machine takes, not the robot.
    """

    traffic: Traffic
    epoch_ns: int | None
    least_timeout: float

    def __call__(self) -> float:
        """Now."""

    def sleep_until(self, due: float) -> None:
        """Returns at a time (s), or as soon after it as the machine can."""

    def wait_readable(self, descriptor: int, timeout: float) -> bool:
        """Waits for something to read from a file for at most a time (s); whether there is."""

    def close(self) -> None:
        """No longer goes by this clock."""


class MachineClock:
    """The machine's monotonic clock."""

    epoch_ns: int | None = None
    least_timeout = 0.0

    def __init__(self) -> None:
        self.traffic = Traffic()

    def __call__(self) -> float:
        """Now."""
        return time.monotonic()

    def sleep_until(self, due: float) -> None:
        """Returns at a time (s), or as soon after it as the machine can."""
        time.sleep(max(0.0, due - time.monotonic()))

    def wait_readable(self, descriptor: int, timeout: float) -> bool:
        """Waits for something to read from a file for at most a time (s); whether there is."""
        return bool(select.select([descriptor], [], [], max(timeout, 0.0))[0])

    def close(self) -> None:
        """Nothing to do."""
