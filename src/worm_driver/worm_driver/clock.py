# SPDX-License-Identifier: Apache-2.0
"""Clocks of the threads that work with a robot: the clock of the machine, or the clock of a virtual robot.

A virtual robot has its own time, which passes only while every thread that works with the robot waits
(worm_driver/simulated_clock.py). A thread that waits only on the virtual robot's clock meets its deadlines on a
slow machine, too.
"""

import select
import time
from dataclasses import dataclass
from typing import Protocol


@dataclass
class Traffic:
    """Bytes that the user of a clock has written to its serial line and read from it. The serial port counts them."""

    written: int = 0
    read: int = 0


class Clock(Protocol):
    """Clock of a thread. A call returns the time (s, monotonic).

    Attributes:
        traffic: bytes that the thread has written to its serial line and read from it.
        epoch_ns: ROS time at which the clock shows 0, ns; None if the ROS clock can be set independently
            of this clock.
        least_timeout: lower bound of the timeouts of calls to other threads, s of the machine's time.
    """

    traffic: Traffic
    epoch_ns: int | None
    least_timeout: float

    def __call__(self) -> float:
        """Return the present time, s."""

    def sleep_until(self, due: float) -> None:
        """Sleep until a time (s). Return as soon after this time as the machine permits."""

    def wait_readable(self, descriptor: int, timeout: float) -> bool:
        """Wait at most ``timeout`` (s) for data on a file descriptor. Return True if there is data."""

    def close(self) -> None:
        """Stop using this clock."""


class MachineClock:
    """The machine's monotonic clock."""

    epoch_ns: int | None = None
    least_timeout = 0.0

    def __init__(self) -> None:
        self.traffic = Traffic()

    def __call__(self) -> float:
        """Return the present time, s."""
        return time.monotonic()

    def sleep_until(self, due: float) -> None:
        """Sleep until a time (s). Return as soon after this time as the machine permits."""
        time.sleep(max(0.0, due - time.monotonic()))

    def wait_readable(self, descriptor: int, timeout: float) -> bool:
        """Wait at most ``timeout`` (s) for data on a file descriptor. Return True if there is data."""
        return bool(select.select([descriptor], [], [], max(timeout, 0.0))[0])

    def close(self) -> None:
        """Do nothing."""
