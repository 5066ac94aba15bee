# SPDX-License-Identifier: Apache-2.0
"""Whether the owner of a run is still heard."""

import math

#: s between two looks
PERIOD = 0.1


class Owner:
    """Of one run. One thread hears, another one looks.

    What the driver itself was late between two looks is not its owner's silence: those beats wait in its queues.

    Args:
        patience: s of silence that the run puts up with; infinite where its owner need not be heard.
        now: s, monotonic.
    """

    def __init__(self, patience: float, now: float):
        self.patience = patience
        self._silence = 0.0
        self._looked = now
        self._heard = False

    def hear(self) -> None:
        """A beat has come."""
        self._heard = True

    def is_silent(self, now: float) -> bool:
        """Whether it has been silent for too long; to be asked every PERIOD, with the time (s, monotonic)."""
        watched = min(now - self._looked, 2.0 * PERIOD)
        self._looked = now
        self._silence = 0.0 if self._heard else self._silence + watched
        self._heard = False
        return self._silence > self.patience


def patience_of(asked: float, demanded: float) -> float:
    """The shorter of what a goal asks for and what the driver demands (s); 0 of either means nothing."""
    return min((value for value in (asked, demanded) if value > 0.0), default=math.inf)
