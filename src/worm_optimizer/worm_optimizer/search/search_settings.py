# SPDX-License-Identifier: Apache-2.0
"""All settings of an optimisation in one frozen value, so that fronts can be cached by them."""

from __future__ import annotations

import enum
from dataclasses import dataclass, field

import numpy as np

from worm_model.gait import MAX_MARGIN
from worm_optimizer.search.actuator_limits import ActuatorLimits
from worm_optimizer.search.gait_map import MapSettings
from worm_optimizer.search.nsga2 import SearchSettings
from worm_optimizer.search.optimizer_errors import OptimizerError
from worm_optimizer.search.task import Array, Bounds

_MOST_MARGINS = 10_000


@dataclass(frozen=True)
class ScanSettings:
    """Margins of the price-of-robustness scan, in m: from ``lowest`` to ``highest`` by ``step``."""

    lowest: float = 0.0
    highest: float = 8e-3
    step: float = 1e-4

    def __post_init__(self) -> None:
        if not (0.0 <= self.lowest < self.highest <= MAX_MARGIN and self.step > 0.0):
            raise OptimizerError(
                f"scan: from {self.lowest} to {self.highest} m by {self.step} m: "
                f"give 0 <= lowest < highest <= {MAX_MARGIN:g} m and a positive step"
            )
        if (self.highest - self.lowest) / self.step > _MOST_MARGINS:
            raise OptimizerError(
                f"scan: a step of {self.step:g} m makes more than {_MOST_MARGINS} margins: give a larger one"
            )

    def margins(self) -> Array:
        """The margins in m; the last is the highest or less than a step below it."""
        count = int(np.floor((self.highest - self.lowest) / self.step + 1e-9)) + 1
        # Rounded to picometres, so that 3.4 mm is 0.0034 and not 0.0034000000000000002.
        return np.round(self.lowest + self.step * np.arange(count), 12)


class Robustness(str, enum.Enum):
    """What keeps gaits away from the edges of their branch."""

    MARGIN = "margin"  # the paper's enlarged threshold
    CHANCE = "chance"  # the promised grooves are kept with a probability, groove phase known
    ANY_PHASE = "any_phase"  # the promised grooves are kept at every groove phase


def robustness_of(name: str) -> Robustness:
    """The kind of robustness of that name; raises `OptimizerError` naming those that there are."""
    try:
        return Robustness(name)
    except ValueError:
        known = ", ".join(each.value for each in Robustness)
        raise OptimizerError(f"robustness: {name!r} is none of {known}") from None


@dataclass(frozen=True)
class Settings:
    """What an optimisation is done with.

    ``margin`` in m, None: chosen at the cliff of the scan; ``probability`` is that of
    `Robustness.CHANCE`; ``samples`` are those of the Monte Carlo success probability and ``served`` the
    number of gaits of a front that are kept to answer requests.
    """

    bounds: Bounds = field(default_factory=Bounds)
    limits: ActuatorLimits = field(default_factory=ActuatorLimits)
    search: SearchSettings = field(default_factory=SearchSettings)
    map: MapSettings = field(default_factory=MapSettings)
    scan: ScanSettings = field(default_factory=ScanSettings)
    robustness: Robustness = Robustness.MARGIN
    margin: float | None = None
    probability: float = 0.95
    samples: int = 500
    served: int = 100

    def __post_init__(self) -> None:
        if self.margin is not None and not 0.0 <= self.margin <= MAX_MARGIN:
            raise OptimizerError(
                f"margin: {self.margin} m is not between 0 and {MAX_MARGIN:g} m; "
                "leave it out to have it chosen at the cliff"
            )
        if not (1 <= self.samples <= 1_000_000 and 3 <= self.served <= 100_000):
            raise OptimizerError(
                f"samples {self.samples} and served gaits {self.served}: "
                "give at least 1 sample and 3 gaits, at most 1000000 and 100000"
            )
