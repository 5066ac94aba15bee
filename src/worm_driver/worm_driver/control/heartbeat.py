# SPDX-License-Identifier: Apache-2.0
"""Supervision of the heartbeats of a client that has started a run."""

import math

#: Period of the checks, s.
PERIOD = 0.1


class HeartbeatMonitor:
    """Heartbeat monitor of one run. One thread may record heartbeats while another one checks them.

    The intervals between the checks add up to the silence, and a heartbeat resets it to 0. An interval counts as at
    most two periods. If it is longer, the driver itself was late, and heartbeats may wait in its queues.

    Args:
        timeout: heartbeat timeout, s; infinite if no heartbeats are required.
        now: present time, s, monotonic.
    """

    def __init__(self, timeout: float, now: float):
        self.timeout = timeout
        self._silence = 0.0
        self._last_check = now
        self._received = False

    def record(self) -> None:
        """Record a heartbeat."""
        self._received = True

    def is_silent(self, now: float) -> bool:
        """Return True if the heartbeat timeout has expired. Call it every PERIOD with the time (s, monotonic)."""
        watched = min(now - self._last_check, 2.0 * PERIOD)
        self._last_check = now
        self._silence = 0.0 if self._received else self._silence + watched
        self._received = False
        return self._silence > self.timeout


def shorter_timeout(requested: float, required: float) -> float:
    """Return the shorter of the goal's and the driver's heartbeat timeout, s.

    An argument of 0 stands for no timeout. If both are 0, the result is infinity.
    """
    return min((value for value in (requested, required) if value > 0.0), default=math.inf)
