# SPDX-License-Identifier: Apache-2.0
"""Distinction between a fresh and a late answer by the servo's own clock.

A status packet does not contain the request that it answers, so a late answer looks like the answer to the next
request. Every block that the driver trusts contains the servo's Realtime Tick (addr 120, ms, wraps after 32767). The
tick of an answer must not lie before its request. The clock restarts with the servo, which reveals a restart.

Every answer, also a late one, is a lower bound of the lead of the servo's clock over the host's. No answer is made
after it was received. The largest bound is stored. It decreases only by the possible drift between the clocks, so a
late answer can never make a later good one look old.
"""

from dataclasses import dataclass

WRAP_S = 32.768
#: Jump of a clock that reveals a restart, s. No answer is so late.
RESTART = 0.3
#: Largest apparent age of a fresh answer before its request, s. The tick and the moment at which the servo updates its
#: table are truncated to whole ms; half of the value is reserve. A late answer is older by a wait, at least 4 ms.
RESOLUTION = 3e-3
#: Largest drift between two clocks, s/s.
_DRIFT = 2e-3


@dataclass(frozen=True)
class TickClock:
    """Lead of a servo's clock over the host's.

    Attributes:
        lead: largest observed (tick - host time of reception), modulo the wrap, s.
        time: host time of the last update, s.
    """

    lead: float
    time: float


def begin(tick_s: float, received: float) -> TickClock:
    """Return the clock after the first answer, received at a host time (s)."""
    return TickClock((tick_s - received) % WRAP_S, received)


def jump(clock: TickClock, tick_s: float, received: float) -> float:
    """Return the lead of an answer over its clock so far (s); negative for a delayed answer."""
    return _wrapped(tick_s - received - clock.lead)


def update(clock: TickClock, tick_s: float, received: float) -> TickClock:
    """Return the clock after an answer of the same servo, late or not."""
    sunk = -_DRIFT * max(0.0, received - clock.time)
    ahead = max(jump(clock, tick_s, received), sunk)
    return TickClock((clock.lead + ahead) % WRAP_S, received)


def age(clock: TickClock, tick_s: float, asked: float) -> float:
    """Return the smallest possible age of an answer at its request (s); negative if it was made later."""
    return _wrapped(asked - (tick_s - clock.lead))


def _wrapped(difference: float) -> float:
    return (difference + WRAP_S / 2) % WRAP_S - WRAP_S / 2
