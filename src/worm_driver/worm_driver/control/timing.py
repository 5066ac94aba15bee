# SPDX-License-Identifier: Apache-2.0
"""Grid of deadlines, and measurement of how punctually a loop meets them."""

import math
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, field


@dataclass(frozen=True)
class DeadlineGrid:
    """Deadlines at start + n · period for whole n, s, monotonic. A missed deadline is skipped, without catching up."""

    start: float
    period: float

    def next_after(self, now: float) -> float:
        """Return the first deadline later than a time (s)."""
        return self.start + (math.floor((now - self.start) / self.period + 1e-9) + 1) * self.period


@dataclass(frozen=True)
class TimingReport:
    """Timing of a periodic loop over its last cycles. All times are NaN until the first period has been measured.

    Attributes:
        mean_period: mean period, s.
        p99_error: 99th percentile of |period - nominal|, s.
        max_error: largest |period - nominal|, s.
        p99_wake: 99th percentile of the delay between a deadline and the start of its cycle, s. Caused by the
            computer.
        p99_cycle: 99th percentile of the duration of a cycle, s. It depends on the device and the interpreter.
        missed: number of deadlines skipped since the start.
        cycles: number of cycles since the start.
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
    """Collector of the periods of a loop.

    Attributes:
        period: nominal period, s.
        window: number of periods that a report covers.
        missed: number of deadlines skipped so far.
        cycles: number of cycles so far.
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
        """Record the start of a cycle.

        Args:
            start: time at which the cycle began, s.
            due: its deadline, s.
            skipped: number of deadlines skipped before it.
        """
        self.cycles += 1
        self.missed += skipped
        self._wakes.append(start - due)
        if self._last is not None:
            self._periods.append(start - self._last)
        self._last = start

    def end(self, now: float) -> None:
        """Record the end of the present cycle at a time (s)."""
        if self._last is not None:
            self._durations.append(now - self._last)

    def pause(self) -> None:
        """Exclude the time until the next cycle from the periods."""
        self._last = None

    def report(self) -> TimingReport:
        """Return the timing of the last `window` cycles, and the numbers of cycles and missed deadlines so far."""
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
    """Return the nearest-rank percentile: the smallest value v such that at least a fraction of the values is <= v."""
    ordered = sorted(values)
    return ordered[max(0, math.ceil(fraction * len(ordered)) - 1)]
