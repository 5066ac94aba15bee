# SPDX-License-Identifier: Apache-2.0
"""Values that the optimizer's tests share: coarse settings, made-up fronts."""

import dataclasses
from pathlib import Path

from worm_optimizer.robustness.prediction import Prediction
from worm_optimizer.search.cache import Cache
from worm_optimizer.search.front import RobustFront
from worm_optimizer.search.gait_map import MapSettings
from worm_optimizer.search.nsga2 import SearchSettings
from worm_optimizer.search.search_settings import ScanSettings, Settings

COARSE_MAP = MapSettings(strokes=25, frequencies=9, tolerance=2e-5, followed=1)

# A front in a second: few margins, few generations, few draws.
QUICK = Settings(
    search=SearchSettings(population=20, generations=6),
    map=COARSE_MAP,
    scan=ScanSettings(lowest=0.0, highest=4e-3, step=1e-3),
    samples=20,
    kept_gaits=12,
)


def made_up(speed: float, power: float, **changes: float) -> Prediction:
    """A prediction whose figures other than speed in m/s and power in W are of no interest."""
    plain = Prediction(
        *(0.07, speed / 0.0346, 1, 0.0034, speed, power, power / speed, 2.0, 0.0011),
        *(speed, power, power / speed, 2.0, 0.005, 0.01, 1.0, 0.5),
    )
    return dataclasses.replace(plain, **changes)


def made_up_front(direction: int = 1) -> RobustFront:
    """Three gaits of which the second has the lowest cost of transport."""
    gaits = [made_up(0.002, 1.4), made_up(0.005, 2.6), made_up(0.008, 4.5)]
    gaits = [dataclasses.replace(gait, direction=direction) for gait in gaits]
    return RobustFront(direction, 0.0034, "given", "nsga2", 0.999, (), tuple(gaits))


def cache_in(folder: Path) -> Cache:
    """A cache in a new folder of a test's own."""
    return Cache.at(folder / "cache")
