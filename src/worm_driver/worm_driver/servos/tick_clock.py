# SPDX-License-Identifier: Apache-2.0
"""Tells a fresh answer from a late one by the servo's own clock.

A status packet does not say which question it answers, so an answer that comes after its timeout looks like the
answer to the next question. Every block that the driver trusts holds the servo's Realtime Tick (addr 120, ms, wraps
after 32767): the tick of an answer must not lie before its question. The same clock starts anew with the servo, which
shows a restart.

How far the servo's clock is ahead of the host's is bounded from below by every answer, a late one too: none is made
after it was received. The largest bound stands, and sinks only by what two clocks may drift apart; so no answer,
however late, can make a later good one look old.
"""

from dataclasses import dataclass

WRAP_S = 32.768
#: s, an answer whose clock is off by more than this comes from a servo that has restarted: none is so late
RESTART = 0.3
#: s, by which a fresh answer may seem older than its question: the tick is cut off to whole ms, and so is the moment at
#: which the servo brings its table up to date; half of it is reserve. A late answer is older by a wait, 4 ms at least.
RESOLUTION = 3e-3
#: s per s, by which two clocks are allowed to drift apart
_DRIFT = 2e-3


@dataclass(frozen=True)
class TickClock:
    """How far a servo's clock is ahead of the host's.

    Attributes:
        lead: s, largest seen (tick - host time at which the answer came), modulo the wrap.
        time: s, host time at which it was last updated.
    """

    lead: float
    time: float


def begin(tick_s: float, received: float) -> TickClock:
    """From the first answer, which came at a host time (s)."""
    return TickClock((tick_s - received) % WRAP_S, received)


def jump(clock: TickClock, tick_s: float, received: float) -> float:
    """By how much (s) an answer is ahead of what its clock has shown so far; negative for one that took its time."""
    return _wrapped(tick_s - received - clock.lead)


def update(clock: TickClock, tick_s: float, received: float) -> TickClock:
    """The clock after an answer of the same servo, whether late or not."""
    sunk = -_DRIFT * max(0.0, received - clock.time)
    ahead = max(jump(clock, tick_s, received), sunk)
    return TickClock((clock.lead + ahead) % WRAP_S, received)


def age(clock: TickClock, tick_s: float, asked: float) -> float:
    """How long (s) before its question an answer was made, at least; negative for one that was made after it."""
    return _wrapped(asked - (tick_s - clock.lead))


def _wrapped(difference: float) -> float:
    return (difference + WRAP_S / 2) % WRAP_S - WRAP_S / 2
