# SPDX-License-Identifier: Apache-2.0
"""Simulated time, which never advances past an event that a client waits for, and never while a client computes.

The methods do not read the machine's time, which is an argument.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass

from worm_driver.simulated_clock import SERIAL, Wait

#: Largest delay that simulated time catches up by advancing faster than its rate, s of machine time.
_SLACK = 0.1
#: Duration of a serial client's wait after which bytes that are still in transit count as lost, s of machine time.
_LOST = 2.0


@dataclass
class ClockClient:
    """Client of the simulated clock.

    Attributes:
        port: interface that the client uses (simulated_clock.SERIAL or I2C).
        wait: event that the client waits for; None while it computes.
        since: machine time at which the wait started, s.
    """

    port: bytes
    wait: Wait | None = None
    since: float = 0.0

    def waits(self, sent: float, received: float) -> bool:
        """Return True if the client is idle: it waits, and no bytes to or from it are in transit.

        Args:
            sent: number of bytes that the server has sent over the serial line.
            received: number of bytes that the server has received over the serial line.
        """
        if self.wait is None or self.port != SERIAL:
            return self.wait is not None
        all_read = not self.wait.listening or self.wait.read >= sent
        return all_read and received >= self.wait.written

    def has_lost_bytes(self, machine: float, sent: float, received: float) -> bool:
        """Return True if bytes to or from a client have been in transit for so long that they count as lost.

        A client that computes or is idle has lost no bytes, however long.

        Args:
            machine: machine time, s.
            sent, received: numbers of bytes over the serial line, as for `waits`.
        """
        if self.wait is None or self.waits(sent, received):
            return False
        return machine - self.since > _LOST


@dataclass
class ClockServer:
    """Simulated time and its rate.

    Attributes:
        rate: largest ratio of simulated to machine time; inf for as fast as possible.
        now: simulated time, s.
    """

    rate: float = 1.0
    now: float = 0.0
    _start: float = 0.0
    _machine: float = 0.0

    def begin(self, machine: float) -> None:
        """Let simulated time continue from its present value at a machine time (s)."""
        self._start, self._machine = machine - self.now / self._pace, machine

    @property
    def _pace(self) -> float:
        """Rate for computations; 1 if the rate is infinite."""
        return self.rate if math.isfinite(self.rate) else 1.0

    def alone(self, machine: float) -> float:
        """Advance simulated time at its rate, without clients, until a machine time (s). Return simulated time."""
        self.now = max(self.now, (machine - self._start) * self._pace)
        self._machine = machine
        return self.now

    def together(self, machine: float, clients: Iterable[bool], until: float) -> float:
        """Advance simulated time as far as the clients allow, and return simulated time.

        Args:
            machine: machine time, s.
            clients: for each client, True if it is idle. Time advances only if all clients are idle.
            until: simulated time of the next event, s. Time does not advance past it.
        """
        waiting = all(clients)
        self._machine = machine
        if waiting:
            due = until if math.isinf(self.rate) else (machine - self._start) * self.rate
            self.now = max(self.now, min(due, until))
        behind = (machine - self._start) - self.now / self._pace
        self._start += max(0.0, behind - _SLACK)
        return self.now

    def machine_time(self, event: float) -> float:
        """Return the machine time (s) at which simulated time reaches an event (s) if no client delays it."""
        return self._machine if math.isinf(self.rate) else self._start + event / self.rate
