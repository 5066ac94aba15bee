# SPDX-License-Identifier: Apache-2.0
"""What measured gaits say about the predictions: in agreement or not, in the same order or not."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from worm_optimizer.report.expectation import Band
from worm_optimizer.report.recorded import RecordedGait

QUANTITIES = ("speed", "power", "cost_of_transport")
_TITLES = {"min_power": "minimum power", "cruise": "cruising", "max_speed": "maximum speed"}


@dataclass(frozen=True)
class Order:
    """Of one quantity: names of the gaits by rising expected and by rising measured value; None where one is NaN."""

    quantity: str
    expected: tuple[str, ...]
    measured: tuple[str, ...] | None

    @property
    def preserved(self) -> bool | None:
        """Whether both are the same; None if that cannot be told."""
        return None if self.measured is None else self.measured == self.expected


@dataclass(frozen=True)
class Agreement:
    """One figure of one gait."""

    gait: str
    quantity: str
    measured: Band
    expected: Band

    @property
    def agrees(self) -> bool | None:
        """Whether the expected 95 % interval and the span of the measured cycles overlap; None if not measured.

        The span stands for the uncertainty of the measurement: noise of the instruments, and grooves that differ.
        """
        if math.isnan(self.measured.value):
            return None
        return self.expected.overlaps(self.measured)

    @property
    def difference(self) -> float:
        """Measured over expected, less 1; NaN where there is none."""
        return self.measured.value / self.expected.value - 1.0 if self.expected.value else math.nan


def title_of(name: str) -> str:
    """A gait's name in words, where it is one of the campaign's."""
    return _TITLES.get(name, name)


def percent(difference: float) -> str:
    """A relative difference with its sign, such as ``+0.3 %``; empty where there is none."""
    return f"{round(100.0 * difference, 1) + 0.0:+.1f} %" if math.isfinite(difference) else ""


def orders(gaits: Sequence[RecordedGait]) -> tuple[Order, ...]:
    """The order of at least two gaits in speed, power and cost of transport."""
    if len(gaits) < 2:
        return ()
    return tuple(_order(gaits, quantity) for quantity in QUANTITIES)


def agreements(gait: RecordedGait) -> tuple[Agreement, ...]:
    """Measured against expected, figure by figure."""
    return tuple(
        Agreement(gait.name, name, getattr(gait.measured, name), getattr(gait.expected.bands, name))
        for name in QUANTITIES
    )


def _order(gaits: Sequence[RecordedGait], quantity: str) -> Order:
    expected = {gait.name: getattr(gait.expected.bands, quantity).value for gait in gaits}
    measured = {gait.name: getattr(gait.measured, quantity).value for gait in gaits}
    known = not any(map(math.isnan, measured.values()))
    return Order(
        quantity,
        tuple(sorted(expected, key=expected.__getitem__)),
        tuple(sorted(measured, key=measured.__getitem__)) if known else None,
    )
