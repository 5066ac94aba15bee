# SPDX-License-Identifier: Apache-2.0
"""Tells a fresh answer from a late one by the servo's own clock.

A status packet does not say which question it answers, so an answer that comes after its timeout looks like the
answer to the next question. Every block that the driver reads in its cycle holds the servo's Realtime Tick (addr 120,
ms, wraps after 32767): the tick of an answer must not lie before its question. The same clock restarts with the
servo, which shows a reboot.
"""

from dataclasses import dataclass

_WRAP_S = 32.768
#: s, how much a late answer may lag unnoticed; a tick is 1 ms, and a cycle at least 5 ms
TOLERANCE = 0.004
#: s per s, by which two clocks are allowed to drift apart
_DRIFT = 2e-3


@dataclass(frozen=True)
class TickClock:
    """Offset of a servo's clock against the host's.

    Attributes:
        delay: s, least seen (tick - host time of the question), modulo the wrap.
        time: s, host time at which it was last updated.
    """

    delay: float
    time: float


def begin(asked: float, tick_s: float) -> TickClock:
    """From a first answer that is known to be fresh (the line was quiet before it)."""
    return TickClock((tick_s - asked) % _WRAP_S, asked)


def lag(clock: TickClock, asked: float, tick_s: float) -> float:
    """How long (s) before its question an answer was made; negative for a fresh one that took its time."""
    difference = (clock.delay - (tick_s - asked)) % _WRAP_S
    return difference - _WRAP_S if difference > _WRAP_S / 2 else difference


def update(clock: TickClock, asked: float, tick_s: float) -> TickClock:
    """The clock after a fresh answer: follows the promptest answers, and lets the clocks drift."""
    elapsed = asked - clock.time
    late = -lag(clock, asked, tick_s)
    return TickClock((clock.delay + min(late, _DRIFT * elapsed)) % _WRAP_S, asked)
