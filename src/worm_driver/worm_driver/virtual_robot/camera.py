# SPDX-License-Identifier: Apache-2.0
"""Position sensor of the virtual robot: a camera with noise, occlusions and latency."""

import math
from dataclasses import dataclass
from random import Random

from worm_driver.virtual_robot.virtual_settings import TrackerSettings


@dataclass(frozen=True)
class TrackerSample:
    """Positions measured in one exposure.

    Attributes:
        time: time of the exposure, s.
        rear_position, front_position: x1 and x2, m; NaN while the marker is hidden.
        available: time at which the sample can be read, s.
    """

    time: float
    rear_position: float
    front_position: float
    available: float


class Tracker:
    """Camera with a fixed rate. The zero of both positions is the initial position of the rear module without a load.

    Attributes:
        next_exposure: time of the next exposure, s.
    """

    def __init__(self, settings: TrackerSettings, random: Random) -> None:
        self._settings = settings
        self._random = random
        self._exposures = 0
        self._hidden_until = [0.0, 0.0]
        self.next_exposure = 0.0

    def expose(self, time: float, rear: float, front: float) -> TrackerSample:
        """Return a noisy sample of the true positions x1 and x2 (m) at a time (s)."""
        self._exposures += 1
        self.next_exposure = self._exposures / self._settings.rate
        positions = [self._see(marker, time, true) for marker, true in enumerate((rear, front))]
        return TrackerSample(time, positions[0], positions[1], time + self._settings.latency)

    def _see(self, marker: int, time: float, true: float) -> float:
        # Both numbers are drawn each time, so that an occlusion does not change the noise after it.
        starts = self._random.random() < self._settings.occlusion_rate / self._settings.rate
        noise = self._random.gauss(0.0, self._settings.noise)
        if starts and time >= self._hidden_until[marker]:
            self._hidden_until[marker] = time + self._settings.occlusion
        return math.nan if time < self._hidden_until[marker] else true + noise
