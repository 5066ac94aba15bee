# SPDX-License-Identifier: Apache-2.0
"""Detection of rest from tracker samples, because a body still extends slowly after its cable has been paid out."""

import math
from collections import deque
from collections.abc import Iterable, Sequence

#: s, time for which both modules must be at rest before a gait. The twin determines the initial length from the samples
#: of this span.
SPAN = 1.0
#: m, largest difference between the mean positions in the two halves of the span at which a module counts as at
#: rest. It is about the noise of a tracker
TOLERANCE = 3e-4
#: smallest number of known positions of a module in each half of the span
FEWEST = 3
#: smallest part of the span that the known positions of a module must cover. It is less than 1, because the samples
#: do not arrive at equal intervals.
_COVERED = 0.95


class Stillness:
    """Detector of rest.

    Attributes:
        lasts: True if both modules were at rest in all samples of the last SPAN. False with too few samples, and until
            the known positions of both modules cover the span.
    """

    def __init__(self) -> None:
        self.lasts = False
        self._samples: deque[tuple[float, float, float]] = deque()

    def observe(self, time: float, rear: float, front: float) -> None:
        """Add a sample: time of reception (s) and positions (m); a position is NaN while its marker is hidden.

        A sample with an earlier time than the previous one is from another clock. It clears the previous samples.
        """
        if self._samples and time < self._samples[-1][0]:
            self._samples.clear()
        self._samples.append((time, rear, front))
        while self._samples[0][0] < time - SPAN:
            self._samples.popleft()
        self.lasts = all(
            _is_at_rest(
                [(then, places[module]) for then, *places in self._samples], time - SPAN / 2
            )
            for module in (0, 1)
        )


def _is_at_rest(samples: Iterable[tuple[float, float]], middle: float) -> bool:
    """Return True if a module was at rest, from its samples (s, m) in the span around the time ``middle`` (s)."""
    known = [(then, place) for then, place in samples if math.isfinite(place)]
    before = [place for then, place in known if then < middle]
    after = [place for then, place in known if then >= middle]
    if min(len(before), len(after)) < FEWEST:
        return False
    # Each sample stands for one interval, so that a slow tracker can cover the span, too.
    covered = (known[-1][0] - known[0][0]) * len(known) / (len(known) - 1)
    return covered >= _COVERED * SPAN and abs(_mean(after) - _mean(before)) <= TOLERANCE


def _mean(places: Sequence[float]) -> float:
    return math.fsum(places) / len(places)
