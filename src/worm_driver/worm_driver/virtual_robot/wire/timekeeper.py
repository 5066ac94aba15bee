# SPDX-License-Identifier: Apache-2.0
"""How far the virtual robot's time may go: never past what somebody waits for, never while somebody works.

Pure: the machine's time is an argument.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass

from worm_driver.virtual_robot.wire.virtual_clock import SERIAL, Wait

#: s, which a robot that was held back may hurry to make up for
_SLACK = 0.1
#: s of the machine, after which bytes that are said to be on their way are taken for lost
_LOST = 2.0


@dataclass
class Party:
    """One who takes part.

    Attributes:
        door: which it works with (virtual_clock.SERIAL, I2C).
        wait: what it waits for; None while it works.
        since: s of the machine, when it began to wait.
    """

    door: bytes
    wait: Wait | None = None
    since: float = 0.0

    def waits(self, sent: float, received: float) -> bool:
        """Whether it does nothing but wait, by the bytes sent to it and received from it over the serial line."""
        if self.wait is None or self.door != SERIAL:
            return self.wait is not None
        heard = not self.wait.listening or self.wait.read >= sent
        return heard and received >= self.wait.written

    def has_lost(self, machine: float) -> bool:
        """Whether what is on its way to or from it has been for too long at a time of the machine (s)."""
        return self.wait is not None and self.door == SERIAL and machine - self.since > _LOST


@dataclass
class Timekeeper:
    """The time, and its pace.

    Attributes:
        rate: virtual seconds per second of the machine at most; inf: as fast as it can.
        now: s, the time.
        held: s, by which the time has fallen behind its pace, as it waited for somebody or for the machine.
    """

    rate: float = 1.0
    now: float = 0.0
    held: float = 0.0
    _start: float = 0.0
    _machine: float = 0.0

    def begin(self, machine: float) -> None:
        """The time goes on from a time of the machine (s)."""
        self._start, self._machine = machine - self.now / self._pace, machine

    @property
    def _pace(self) -> float:
        return self.rate if math.isfinite(self.rate) else 1.0

    def alone(self, machine: float) -> float:
        """The time with nobody taking part: it passes at its pace, whatever the machine does."""
        self.now = max(self.now, (machine - self._start) * self._pace)
        self._machine = machine
        return self.now

    def together(self, machine: float, parties: Iterable[bool], until: float) -> float:
        """The time with parties of which each does nothing but wait or not, and an event that must not be passed."""
        waiting = all(parties)
        self._machine = machine
        if waiting:
            due = until if math.isinf(self.rate) else (machine - self._start) * self.rate
            self.now = max(self.now, min(due, until))
        behind = (machine - self._start) - self.now / self._pace
        late = max(0.0, behind - _SLACK)
        self._start += late
        self.held += late
        return self.now

    def machine_time(self, event: float) -> float:
        """When (s of the machine) the time of an event comes, if nobody keeps it."""
        return self._machine if math.isinf(self.rate) else self._start + event / self.rate
