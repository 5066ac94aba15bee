# SPDX-License-Identifier: Apache-2.0
"""Study that is computed in a second, for tests, and a substitute for its workers."""

from collections.abc import Iterator
from typing import Any

SMALL = """\
title: small
vary:
  slack: [0.004, 0.008, 0.012]
  switching_threshold: [0.008, 0.0175]     # 8 mm is less than half the pitch: not admissible
fixed: {margin_m: 0.002, at_power_W: 2.6}
compute: [front, gaits]
resolution: {strokes: 9, frequencies: 5, front_gaits: 4, samples: 10}
"""


class Here:
    """Computation in this process, in place of workers; ``pieces`` is the number of blocks so far."""

    def __init__(self) -> None:
        self.pieces = 0
        self.most = 1_000_000

    def __call__(self, task: Any, pieces: Any, workers: Any, say: Any) -> Iterator[Any]:
        """Yield the blocks; raise KeyboardInterrupt after ``most`` blocks."""
        for piece in pieces:
            if self.pieces >= self.most:
                raise KeyboardInterrupt
            self.pieces += 1
            yield {"items": piece, **task.function(task.common, piece)}
