# SPDX-License-Identifier: Apache-2.0
"""Tells a fresh answer from a late one by the servo's own clock.

A status packet does not say which question it answers, so an answer that comes after its timeout looks like the
answer to the next question. Every block that the driver reads in its cycle holds the servo's Realtime Tick (addr 120,
ms, wraps after 32767): the tick of an answer must not lie before its question. The same clock starts anew with the
servo, which shows a restart.
"""

from collections.abc import Iterable
from dataclasses import dataclass

WRAP_S = 32.768
#: s, an answer whose clock is off by more than this comes from a servo that has restarted: none is so late
RESTART = 1.0
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


def begin(answers: Iterable[tuple[float, float]]) -> TickClock:
    """From the first answers, (host time of the question s, tick s), which are known to be fresh."""
    (asked, tick), *rest = answers
    clock = TickClock((tick - asked) % WRAP_S, asked)
    for later_asked, later_tick in rest:
        clock = update(clock, later_asked, later_tick)
    return clock


def lag(clock: TickClock, asked: float, tick_s: float) -> float:
    """How long (s) before its question an answer was made; negative for one that took its time."""
    difference = (clock.delay - (tick_s - asked)) % WRAP_S
    return difference - WRAP_S if difference > WRAP_S / 2 else difference


def update(clock: TickClock, asked: float, tick_s: float) -> TickClock:
    """The clock after a fresh answer: follows the promptest answers, and lets the clocks drift."""
    late = -lag(clock, asked, tick_s)
    return TickClock((clock.delay + min(late, _DRIFT * (asked - clock.time))) % WRAP_S, asked)
