# SPDX-License-Identifier: Apache-2.0
"""Rest is seen, not assumed: a body that was stopped while contracted creeps on after its cable is paid out."""

import math
from collections import deque
from collections.abc import Iterable

#: s before a gait in which the robot must have stood: the twin takes its initial length from them
SPAN = 1.0
#: m, by which the mean positions of the halves of that span may differ; a tracker's noise is about as large
TOLERANCE = 3e-4
#: samples that make a mean
FEWEST = 3


class Stillness:
    """Whether the tracker sees both modules stand.

    Attributes:
        lasts: whether they stood over the SPAN before the last sample; False where too little was seen of it.
    """

    def __init__(self) -> None:
        self.lasts = False
        self._seen: deque[tuple[float, float, float]] = deque()

    def observe(self, time: float, rear: float, front: float) -> None:
        """Takes a sample: s, and positions in m, NaN while a marker is hidden.

        Where the time is earlier than the last one's, it is another clock's, and what was seen before is forgotten.
        """
        if self._seen and time < self._seen[-1][0]:
            self._seen.clear()
        self._seen.append((time, rear, front))
        while self._seen[0][0] < time - SPAN:
            self._seen.popleft()
        before = [places for then, *places in self._seen if then < time - SPAN / 2]
        after = [places for then, *places in self._seen if then >= time - SPAN / 2]
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
