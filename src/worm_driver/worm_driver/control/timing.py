# SPDX-License-Identifier: Apache-2.0
"""A grid of deadlines, and how well it was kept."""

import math
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, field


@dataclass(frozen=True)
class DeadlineGrid:
    """Deadlines at start + n period, s monotonic. A missed one is skipped, not caught up with."""

    start: float
    period: float

    def next_after(self, now: float) -> float:
        """The first deadline later than a time."""
        return self.start + (math.floor((now - self.start) / self.period + 1e-9) + 1) * self.period


@dataclass(frozen=True)
class TimingReport:
    """Quality of a periodic loop over its last cycles; s.

    Attributes:
        mean_period: s; NaN before two cycles.
        p99_error: s, 99th percentile of |period - nominal|; NaN before two cycles.
        max_error: s; NaN before two cycles.
        missed: deadlines skipped since the start.
        cycles: since the start.
    """

    mean_period: float
    p99_error: float
    max_error: float
    missed: int
    cycles: int


@dataclass
class PeriodMeter:
    """Collects the periods of a loop.

    Attributes:
        period: s, nominal.
        window: number of periods that a report covers.
    """

    period: float
    window: int = 1000
    missed: int = 0
    cycles: int = 0
    _last: float | None = None
    _periods: deque[float] = field(default_factory=deque)

    def cycle(self, start: float, skipped: int) -> None:
        """Notes a cycle that began at a time (s), after skipped deadlines."""
        self.cycles += 1
        self.missed += skipped
        if self._last is not None:
            self._periods.append(start - self._last)
            if len(self._periods) > self.window:
                self._periods.popleft()
        self._last = start

    def pause(self) -> None:
        """Notes that the time until the next cycle is no period."""
        self._last = None

    def report(self) -> TimingReport:
        """The quality so far."""
        periods = tuple(self._periods)
        if not periods:
            return TimingReport(math.nan, math.nan, math.nan, self.missed, self.cycles)
        errors = [abs(p - self.period) for p in periods]
        mean = math.fsum(periods) / len(periods)
        return TimingReport(mean, percentile(errors, 0.99), max(errors), self.missed, self.cycles)


def percentile(values: Iterable[float], fraction: float) -> float:
    """The smallest value that at least a fraction of the values do not exceed."""
    ordered = sorted(values)
    return ordered[max(0, math.ceil(fraction * len(ordered)) - 1)]
