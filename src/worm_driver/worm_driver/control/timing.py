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
        p99_wake: s, 99th percentile of how late after its deadline a cycle began: what the computer did.
        p99_cycle: s, 99th percentile of how long a cycle took: what the device and the interpreter did.
        missed: deadlines skipped since the start.
        cycles: since the start.
    """

    mean_period: float
    p99_error: float
    max_error: float
    p99_wake: float
    p99_cycle: float
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
    _periods: deque[float] = field(init=False)
    _wakes: deque[float] = field(init=False)
    _durations: deque[float] = field(init=False)

    def __post_init__(self) -> None:
        self._periods, self._wakes, self._durations = (deque(maxlen=self.window) for _ in range(3))

    def begin(self, start: float, due: float, skipped: int) -> None:
        """Notes a cycle that began at a time (s) and was due at another, after skipped deadlines."""
        self.cycles += 1
        self.missed += skipped
        self._wakes.append(start - due)
        if self._last is not None:
            self._periods.append(start - self._last)
        self._last = start

    def end(self, now: float) -> None:
        """Notes the end of the cycle that was begun last, at a time (s)."""
        if self._last is not None:
            self._durations.append(now - self._last)

    def pause(self) -> None:
        """Notes that the time until the next cycle is no period."""
        self._last = None

    def report(self) -> TimingReport:
        """The quality so far."""
        periods = tuple(self._periods)
        if not periods:
            unknown = (math.nan,) * 5
            return TimingReport(*unknown, self.missed, self.cycles)
        errors = [abs(p - self.period) for p in periods]
        return TimingReport(
            math.fsum(periods) / len(periods),
            percentile(errors, 0.99),
            max(errors),
            percentile(self._wakes, 0.99),
            percentile(self._durations, 0.99),
            self.missed,
            self.cycles,
        )


def percentile(values: Iterable[float], fraction: float) -> float:
    """The smallest value that at least a fraction of the values do not exceed."""
    ordered = sorted(values)
    return ordered[max(0, math.ceil(fraction * len(ordered)) - 1)]
