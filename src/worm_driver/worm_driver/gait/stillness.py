# SPDX-License-Identifier: Apache-2.0
"""Detection of rest from tracker samples, because a body still extends slowly after its cable has been paid out."""

import math
from collections import deque
from collections.abc import Iterable

#: s, time for which both modules must be at rest before a gait. The twin determines the initial length from the samples
#: of this span.
SPAN = 1.0
#: m, largest difference between the mean positions in the two halves of the span at which a module counts as at
#: rest. It is about the noise of a tracker
TOLERANCE = 3e-4
#: smallest number of known positions of a module in each half of the span
FEWEST = 3


class Stillness:
    """Detector of rest.

    Attributes:
        lasts: True if both modules were at rest in all samples of the last SPAN. False with too few samples.
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
        before = [places for then, *places in self._samples if then < time - SPAN / 2]
        after = [places for then, *places in self._samples if then >= time - SPAN / 2]
        self.lasts = all(
            abs(
                _mean(places[module] for places in after)
                - _mean(places[module] for places in before)
            )
            <= TOLERANCE
            for module in (0, 1)
        )


def _mean(places: Iterable[float]) -> float:
    known = [place for place in places if math.isfinite(place)]
    return math.fsum(known) / len(known) if len(known) >= FEWEST else math.nan
