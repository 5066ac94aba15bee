# SPDX-License-Identifier: Apache-2.0
"""Long work as values: what a worker process is handed, and what it hands back."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from worm_model.parameters import ParameterFile
from worm_optimizer.search.cache import Cache
from worm_optimizer.search.front import Report, make_front, scanned_price
from worm_optimizer.search.margin import PriceOfRobustness
from worm_optimizer.search.search_settings import Settings
from worm_optimizer.search.served import ServedFront


class Job(Protocol):
    """Work that reports its progress and returns one result; raises `OptimizerError` or OSError."""

    def run(self, report: Report) -> object:
        """Does the work."""


@dataclass(frozen=True)
class FrontJob:
    """Computes a front and stores it in the cache."""

    content: ParameterFile
    settings: Settings
    direction: int
    cache: Cache

    def run(self, report: Report) -> ServedFront:
        """See `pipeline.make_front`."""
        return make_front(self.content, self.settings, self.direction, self.cache, report)


@dataclass(frozen=True)
class ScanJob:
    """Scans the margins, or finds the scan in the cache."""

    content: ParameterFile
    settings: Settings
    direction: int
    cache: Cache

    def run(self, report: Report) -> PriceOfRobustness:
        """See `pipeline.scanned_price`."""
        return scanned_price(self.content, self.settings, self.direction, self.cache, report)
