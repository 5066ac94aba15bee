# SPDX-License-Identifier: Apache-2.0
"""Frame of the pipe, colours of the fins, and samples of the tracker, for all pictures of robot and twin.

Fins are green where they hold, amber where they yield, and grey where they touch nothing. Colours are (red, green,
blue, opacity) from 0 to 1.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from worm_model.parameters import Parameters
from worm_model.twin.data.records import NANOSECONDS

FRAME = "pipe"
LOST_S = 1.0  # largest age of the latest tracker sample with which the robot is drawn

Colour = tuple[float, float, float, float]
HOLDING: Colour = (0.1, 0.7, 0.2, 1.0)
YIELDING: Colour = (0.95, 0.6, 0.1, 1.0)
FREE: Colour = (0.6, 0.6, 0.6, 1.0)


@dataclass(frozen=True)
class PositionSample:
    """Latest sample of the tracker: x1 and x2 in m, NaN if not visible, and its stamp in ns."""

    rear_position: float = math.nan
    front_position: float = math.nan
    stamp_ns: int = 0

    def seen_at(self, stamp_ns: int) -> bool:
        """Return True if both positions are known and at most `LOST_S` away from a stamp (ns)."""
        both = math.isfinite(self.rear_position) and math.isfinite(self.front_position)
        return both and abs(stamp_ns - self.stamp_ns) <= LOST_S * NANOSECONDS


def engagement(displacement: float, parameters: Parameters, direction: int) -> Colour:
    """Return the colour of a fin with a deflection (m). A fin holds if it is deflected against ``direction``."""
    if abs(displacement) <= 0.5 * parameters.clearance:
        return FREE
    return HOLDING if displacement * direction < 0.0 else YIELDING
