# SPDX-License-Identifier: Apache-2.0
"""Detection of late answers with the servo's own clock.

A status packet does not contain the request that it answers, so a late answer looks like the answer to the next
request. Every block that the driver trusts contains the servo's Realtime Tick (address 120, ms, wraps after 32767).
The tick of an answer must not be earlier than the request. A restart of the servo also restarts its clock, so a jump of
the clock reveals the restart.

The lead of the servo's clock over the host's is unknown. The tick of an answer minus its time of reception is a lower
bound of the lead, also for a late answer, because an answer is made before it is received. The driver stores the
largest of these bounds, and reduces it with time only by the possible drift between the clocks. So a late answer can
never make a subsequent fresh answer look old.
"""

from dataclasses import dataclass

WRAP_S = 32.768  # period after which Realtime Tick begins at 0 again, s
#: Smallest jump of a clock that counts as a restart of its servo, s. A late answer shows a smaller jump, because no
#: answer is delayed by that much.
RESTART = 0.3
#: Largest time by which a fresh answer may seem to be older than its request, s. The servo truncates both the tick and
#: the moment at which it updates its control table to whole ms, which explains up to 2 ms. The third millisecond is
#: reserve. A late answer is at least 4 ms older than the request, because the wait for the previous answer lasted at
#: least 4 ms.
RESOLUTION = 3e-3
#: Largest drift between the servo's and the host's clock, s/s.
_DRIFT = 2e-3


@dataclass(frozen=True)
class TickClock:
    """Estimated lead of a servo's clock over the host's.

    Attributes:
        lead: largest observed value of (tick - host time of reception), modulo WRAP_S, s. It is reduced by the possible
            drift since the observation.
        time: host time of the last update, s.
    """

    lead: float
    time: float


def begin(tick_s: float, received: float) -> TickClock:
    """Return the clock after the first answer, with a tick (s), received at a host time (s)."""
    return TickClock((tick_s - received) % WRAP_S, received)


def jump(clock: TickClock, tick_s: float, received: float) -> float:
    """Return the tick of an answer minus its time of reception, minus the estimated lead, s.

    The result lies within ±WRAP_S / 2. The later an answer arrives, the lower the result.
    """
    return _wrapped(tick_s - received - clock.lead)


def update(clock: TickClock, tick_s: float, received: float) -> TickClock:
    """Return the clock after a further answer of the servo, late or not, received at a host time (s)."""
    sunk = -_DRIFT * max(0.0, received - clock.time)
    ahead = max(jump(clock, tick_s, received), sunk)
    return TickClock((clock.lead + ahead) % WRAP_S, received)


def age(clock: TickClock, tick_s: float, requested: float) -> float:
    """Return a lower bound of the age (s) of an answer at the time ``requested`` (s) of the request.

    The age is negative if the servo made the answer after the request.
    """
    return _wrapped(requested - (tick_s - clock.lead))


def _wrapped(difference: float) -> float:
    return (difference + WRAP_S / 2) % WRAP_S - WRAP_S / 2
