# SPDX-License-Identifier: Apache-2.0
"""Supervision of the heartbeats that a run's owner sends."""

import math

#: Period of the checks, s.
PERIOD = 0.1


class Owner:
    """Heartbeat monitor of one run. One thread records heartbeats, another one checks them.

    Time in which the driver itself was late does not count as silence, as the heartbeats wait in its queues.

    Args:
        patience: heartbeat timeout, s; infinite if no heartbeats are required.
        now: present time, s, monotonic.
    """

    def __init__(self, patience: float, now: float):
        self.patience = patience
        self._silence = 0.0
        self._looked = now
        self._heard = False

    def hear(self) -> None:
        """Record a heartbeat."""
        self._heard = True

    def is_silent(self, now: float) -> bool:
        """Return True if the heartbeat timeout has expired. Call it every PERIOD with the time (s, monotonic)."""
        watched = min(now - self._looked, 2.0 * PERIOD)
        self._looked = now
        self._silence = 0.0 if self._heard else self._silence + watched
        self._heard = False
        return self._silence > self.patience


def patience_of(asked: float, demanded: float) -> float:
    """Return the shorter of the goal's and the driver's heartbeat timeout, s.

    An argument of 0 stands for no timeout. Without any timeout the result is infinity.
    """
    return min((value for value in (asked, demanded) if value > 0.0), default=math.inf)
