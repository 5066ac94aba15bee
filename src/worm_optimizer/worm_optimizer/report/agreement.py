# SPDX-License-Identifier: Apache-2.0
"""Measured against expected: in agreement or not, in the same order or not; as values, text and JSON."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from worm_optimizer.report.expectation import Band
from worm_optimizer.report.recorded_gait import RecordedGait


@dataclass(frozen=True)
class Quantity:
    """How a number of a gait is written: its ``name``, a factor from SI to the ``unit``, and decimals."""

    name: str
    scale: float
    unit: str
    decimals: int

    def text(self, value: float) -> str:
        """The value without its unit; a dash where there is none."""
        return f"{self.scale * value:.{self.decimals}f}" if math.isfinite(value) else "–"

    def range(self, band: Band) -> str:
        """The bounds without their unit; a dash where there are none."""
        if math.isnan(band.low) or math.isnan(band.high):
            return "–"
        return f"{self.text(band.low)} to {self.text(band.high)}"

    @property
    def title(self) -> str:
        """The name with its unit."""
        return f"{self.name} ({self.unit})" if self.unit else self.name


QUANTITIES = {
    "speed": Quantity("speed", 1e3, "mm/s", 3),
    "power": Quantity("power", 1.0, "W", 3),
    "cost_of_transport": Quantity("cost of transport", 1.0, "", 1),
}
# A difference of this much is never called an agreement, however wide the interval is: it says that too little is
# known of the parameters, not that the prediction is good.
LEAST_DISAGREEMENT = 0.20
NOMINAL = "nominal_"  # begins the name of a gait that was designed without a margin
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
    """One quantity of one gait, a key of `QUANTITIES`."""

    gait: str
    quantity: str
    measured: Band
    expected: Band

    @property
    def agrees(self) -> bool | None:
        """Whether the expected 95 % interval and the span of the measured cycles overlap; None if not measured.

        The span stands for the uncertainty of the measurement: noise of the instruments, and grooves that differ.
        What is `LEAST_DISAGREEMENT` off does not agree.
        """
        if math.isnan(self.measured.value):
            return None
        return abs(self.difference) < LEAST_DISAGREEMENT and self.expected.overlaps(self.measured)

    @property
    def verdict(self) -> str:
        """In a word."""
        return {True: "yes", False: "no", None: "not measured"}[self.agrees]

    @property
    def difference(self) -> float:
        """Measured over expected, less 1; NaN where there is none."""
        return self.measured.value / self.expected.value - 1.0 if self.expected.value else math.nan


def title_of(name: str) -> str:
    """A gait's name in words, where it is one of the campaign's."""
    plain = name.removeprefix(NOMINAL)
    title = _TITLES.get(plain, plain)
    return title if plain == name else f"{title}, nominal"


def percent(difference: float) -> str:
    """A relative difference with its sign, such as ``+0.3 %``; empty where there is none."""
    return f"{round(100.0 * difference, 1) + 0.0:+.1f} %" if math.isfinite(difference) else ""


def orders(gaits: Sequence[RecordedGait]) -> tuple[Order, ...]:
    """The order of at least two gaits in speed, power and cost of transport."""
    if len(gaits) < 2:
        return ()
    return tuple(_order(gaits, quantity) for quantity in QUANTITIES)


def agreements(gait: RecordedGait) -> tuple[Agreement, ...]:
    """Measured against expected, one quantity after the other."""
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


def order_text(order: Order) -> str:
    """An order in words."""
    name = f"order by {QUANTITIES[order.quantity].name}"
    expected = " < ".join(map(title_of, order.expected))
    if order.measured is None:
        return f"{name}: unknown, a number is missing (expected {expected})"
    if order.preserved:
        return f"{name}: preserved, {expected}"
    measured = " < ".join(map(title_of, order.measured))
    return f"{name}: not preserved; expected {expected}, measured {measured}"


def headline(gaits: Sequence[RecordedGait]) -> str:
    """The verdict on all gaits in one sentence; what ended early is said first."""
    rows = [row for gait in gaits for row in agreements(gait)]
    known = [row for row in rows if row.agrees is not None]
    early = [f"{title_of(gait.name)} {gait.early_end}" for gait in gaits if gait.early_end]
    away = [row for row in known if not row.agrees]
    if not known:
        verdict = "Nothing could be measured"
    elif away:
        verdict = f"{len(away)} of {len(known)} numbers do not agree with the prediction"
    elif len(known) == 1:
        verdict = "The one number that was measured agrees with the prediction"
    else:
        verdict = f"All {len(known)} numbers agree with the prediction"
    if known and len(known) < len(rows):
        verdict += f"; {len(rows) - len(known)} could not be measured"
    return ". ".join([*early, verdict]) + "."


def describe(gaits: Sequence[RecordedGait]) -> str:
    """A table for a terminal: each number with its expected 95 % interval, then the orders."""
    heads = ("gait", "", "measured", "expected", "95 % interval", "difference", "agrees")
    rows = [heads, *(_row(row) for gait in gaits for row in agreements(gait))]
    widths = [max(len(row[column]) for row in rows) for column in range(len(heads))]
    lines = [f"{gait.name}: {gait.early_end}" for gait in gaits if gait.early_end]
    lines += [
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
        for row in rows
    ]
    phases = {f"{1e3 * gait.expected.nominal.groove_phase:+.2f} mm": None for gait in gaits}
    lines += ["", f"expected without the margin, at a groove phase of {', '.join(phases)}"]
    lines += map(order_text, orders(gaits))
    lines += [f"{gait.name}: {reason}" for gait in gaits for reason in gait.missing]
    return "\n".join(lines)


def _row(row: Agreement) -> tuple[str, ...]:
    quantity = QUANTITIES[row.quantity]
    return (
        row.gait,
        quantity.title,
        quantity.text(row.measured.value),
        quantity.text(row.expected.value),
        quantity.range(row.expected),
        percent(row.difference) or "–",
        row.verdict,
    )


def agreement_json(gaits: Sequence[RecordedGait]) -> dict[str, Any]:
    """Measured against expected as the machine-readable output has it."""
    return {
        "runs": [
            {
                "name": gait.name,
                "gait": asdict(gait.gait),
                "measured": asdict(gait.measured),
                "expected": asdict(gait.expected.bands),
                "twin": asdict(gait.twin),
                "groove_phase": gait.expected.nominal.groove_phase,
                "agrees": {row.quantity: row.agrees for row in agreements(gait)},
                "missing": list(gait.missing),
                "early_end": gait.early_end,
                "averaged_cycles": list(gait.averaged_cycles),
                "idle_power": gait.idle_power,
            }
            for gait in gaits
        ],
        "order_preserved": {order.quantity: order.preserved for order in orders(gaits)},
    }
