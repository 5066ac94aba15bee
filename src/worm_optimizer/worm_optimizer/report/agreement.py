# SPDX-License-Identifier: Apache-2.0
"""Comparison of measured with expected values, and of the measured with the expected order of the gaits."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from worm_model.text_table import text_table
from worm_optimizer.report.expectation import Band, GrooveShare
from worm_optimizer.report.recorded_gait import RecordedGait


@dataclass(frozen=True)
class Quantity:
    """Format of one measured or expected quantity of a gait.

    ``scale`` is the factor from the SI unit to ``unit``, and ``decimals`` the number of printed decimals.
    """

    name: str
    scale: float
    unit: str
    decimals: int

    def text(self, value: float) -> str:
        """Return the value without its unit, or a dash if it is not finite."""
        return f"{self.scale * value:.{self.decimals}f}" if math.isfinite(value) else "–"

    def range(self, band: Band) -> str:
        """Return both bounds as text without their unit, or a dash if one of them is NaN."""
        if math.isnan(band.low) or math.isnan(band.high):
            return "–"
        return f"{self.text(band.low)} to {self.text(band.high)}"

    @property
    def title(self) -> str:
        """Name with its unit."""
        return f"{self.name} ({self.unit})" if self.unit else self.name


QUANTITIES = {
    "speed": Quantity("speed", 1e3, "mm/s", 3),
    "power": Quantity("power", 1.0, "W", 3),
    "cost_of_transport": Quantity("cost of transport", 1.0, "", 1),
}
# A power or cost of transport with a relative difference of this size or more never counts as agreement. An interval
# that contains such differences shows that the parameters are poorly known, not that the prediction is good.
LEAST_DISAGREEMENT = 0.20
# A gait is fragile if no number of grooves has a probability of CERTAIN or more. A fragile gait never agrees. It
# disagrees if the measured grooves are outside the range of the numbers with a probability of POSSIBLE or more.
CERTAIN, POSSIBLE = 0.9, 0.05
TOO_SHORT = "not compared: fewer than three complete cycles after the first"
# Prefixes of the names of gaits that a campaign runs for comparison: designed without a margin, for level ground, and
# with the paper's waveform.
NOMINAL, LEVEL_GROUND, SINUSOIDAL = "nominal_", "level_", "sinusoid_"
COMPARED = {NOMINAL: "nominal", LEVEL_GROUND: "for level ground", SINUSOIDAL: "sinusoid"}
_TITLES = {"min_power": "minimum power", "cruise": "cruising", "max_speed": "maximum speed"}


@dataclass(frozen=True)
class Grooves:
    """Grooves per cycle of a recorded gait.

    Attributes:
        expected: expected numbers with their probabilities, the most probable first.
        measured: measured grooves per cycle.
        cycles: number of averaged cycles.
    """

    expected: tuple[GrooveShare, ...]
    measured: float
    cycles: int

    @property
    def is_fragile(self) -> bool:
        """True if the probability of the expected (most probable) number of grooves is below CERTAIN."""
        return self.expected[0].probability < CERTAIN

    @property
    def agrees(self) -> bool | None:
        """True if the expected number of grooves was measured, False if not.

        For a fragile gait (`is_fragile`), None if the measured grooves are in the range of the possible numbers, and
        False otherwise. A number is possible if its probability is at least POSSIBLE.
        """
        tolerance = 0.5 / self.cycles
        if not self.is_fragile:
            return abs(self.measured - self.expected[0].grooves) < tolerance
        possible = [share.grooves for share in self.expected if share.probability >= POSSIBLE]
        is_possible = min(possible) - tolerance < self.measured < max(possible) + tolerance
        return None if is_possible else False

    def __str__(self) -> str:
        likely = [share for share in self.expected if share.probability >= 0.005]
        shares = [f"{share.grooves:.3g} with {100 * share.probability:.0f} %" for share in likely]
        word = "groove" if shares[0].startswith("1 ") else "grooves"
        first = shares[0].replace(" with", f" {word} with", 1)
        return f"{', '.join([first, *shares[1:]])}; measured {self.measured:.3g}"


@dataclass(frozen=True)
class Agreement:
    """Measured and expected value of one quantity of a gait.

    Attributes:
        gait: name of the gait.
        quantity: key of `QUANTITIES`.
        measured: mean of the averaged cycles, with the lowest and highest cycle as bounds.
        expected: predicted value with its 95 % interval.
        grooves: grooves per cycle, for the speed only; else None.
        obstacle: reason why the values are not compared; else empty.
    """

    gait: str
    quantity: str
    measured: Band
    expected: Band
    grooves: Grooves | None = None
    obstacle: str = ""

    @property
    def agrees(self) -> bool | None:
        """True if the measured value agrees with the expected one, False if not; None if this cannot be decided.

        The speed agrees if the expected number of grooves was measured. Power and cost of transport agree if the
        expected 95 % interval overlaps the span from the lowest to the highest measured cycle, and if the relative
        difference is below `LEAST_DISAGREEMENT`.
        """
        if self.obstacle or math.isnan(self.measured.value):
            return None
        if not math.isfinite(self.expected.value):
            return None
        if self.grooves is not None:
            return self.grooves.agrees
        return abs(self.difference) < LEAST_DISAGREEMENT and self.expected.overlaps(self.measured)

    @property
    def verdict(self) -> str:
        """Result of the comparison as text."""
        if self.agrees is not None:
            return "agrees" if self.agrees else "disagrees"
        if self.obstacle:
            return self.obstacle
        if math.isnan(self.measured.value):
            return "not measured"
        if math.isinf(self.expected.value):
            return "undefined: no groove is expected"
        if self.grooves is not None:
            return f"fragile: {self.grooves}"
        return "too few draws of the parameters gain the measured grooves"

    @property
    def difference(self) -> float:
        """Relative difference, measured / expected − 1; NaN if it is undefined or the values are not compared."""
        if self.obstacle or not self.expected.value:
            return math.nan
        return self.measured.value / self.expected.value - 1.0


def title_of(name: str) -> str:
    """Return the title of a gait: words such as "cruising" for a gait of a campaign, otherwise the name of the gait."""
    for prefix, text in COMPARED.items():
        if name.startswith(prefix):
            return f"{title_of(name.removeprefix(prefix))}, {text}"
    return _TITLES.get(name, name)


def percent(difference: float) -> str:
    """Return a relative difference with its sign, such as ``+0.3 %``, or an empty string if it is not finite."""
    return f"{round(100.0 * difference, 1) + 0.0:+.1f} %" if math.isfinite(difference) else ""


def agreements(gait: RecordedGait) -> tuple[Agreement, ...]:
    """Return the comparison of measured with expected values, one entry for each of `QUANTITIES`."""
    grooves = {"speed": grooves_of(gait)}
    obstacle = "" if gait.is_steady or math.isnan(gait.measured.speed.value) else TOO_SHORT
    return tuple(
        Agreement(
            gait.name,
            name,
            getattr(gait.measured, name),
            getattr(gait.expected.bands, name),
            grooves.get(name),
            obstacle,
        )
        for name in QUANTITIES
    )


def grooves_of(gait: RecordedGait) -> Grooves | None:
    """Return the grooves per cycle of a recorded gait, or None if its speed was not measured."""
    expected, speed = gait.expected, gait.measured.speed.value
    if math.isnan(speed) or not expected.grooves:
        return None
    measured = speed / (gait.gait.frequency * gait.content.parameters.pitch)
    return Grooves(expected.grooves, measured, expected.cycles)


def orders(gaits: Sequence[RecordedGait]) -> dict[str, tuple[bool | None, str]]:
    """Return whether the measured order of the gaits is the expected one, by quantity, and this as text.

    None means that a value is missing or that two values are equal. With fewer than two gaits, the result is empty.
    """
    return {name: _order(gaits, name) for name in QUANTITIES} if len(gaits) > 1 else {}


def _order(gaits: Sequence[RecordedGait], quantity: str) -> tuple[bool | None, str]:
    expected = _rising({g.name: getattr(g.expected.bands, quantity).value for g in gaits})
    steady = {g.name: getattr(g.measured, quantity).value for g in gaits if g.is_steady}
    measured = _rising(steady) if len(steady) == len(gaits) else ""
    name = f"order by {QUANTITIES[quantity].name}"
    if not expected:
        return None, f"{name}: unknown, an expected value is missing or two are equal"
    if not measured:
        text = "unknown, a measured value is missing or two are equal"
        return None, f"{name}: {text} (expected {expected})"
    if measured == expected:
        return True, f"{name}: preserved, {expected}"
    return False, f"{name}: not preserved; expected {expected}, measured {measured}"


def _rising(values: Mapping[str, float]) -> str:
    """Return the titles of the gaits by rising value; empty if a value is NaN or if two values are equal."""
    different = set(values.values())
    if len(different) < len(values) or any(map(math.isnan, different)):
        return ""
    return " < ".join(map(title_of, sorted(values, key=values.__getitem__)))


def headline(gaits: Sequence[RecordedGait]) -> str:
    """Return the gaits that ended early, and the verdict on all gaits, as text."""
    rows = [row for gait in gaits for row in agreements(gait)]
    known = [row for row in rows if row.agrees is not None]
    early = [f"{title_of(gait.name)} {gait.early_end}" for gait in gaits if gait.early_end]
    away = [row for row in known if not row.agrees]
    if not known:
        verdict = "No number could be compared with the prediction"
    elif away:
        verdict = f"{len(away)} of {len(known)} numbers do not agree with the prediction"
    elif len(known) == 1:
        verdict = "The one number that could be compared agrees with the prediction"
    else:
        verdict = f"All {len(known)} numbers agree with the prediction"
    fragile = [title_of(row.gait) for row in rows if row.verdict.startswith("fragile")]
    if fragile:
        verdict += (
            f"; {', '.join(fragile)}: fragile, the expected grooves are too uncertain for a verdict"
        )
    unknown = len(rows) - len(known) - len(fragile)
    if known and unknown:
        verdict += f"; {unknown} could not be compared"
    return ". ".join([*early, verdict]) + "."


def describe(gaits: Sequence[RecordedGait]) -> str:
    """Return a table for a terminal: each measured value with its expected 95 % interval, then the orders."""
    heads = ("gait", "", "measured", "expected", "95 % interval", "difference", "verdict")
    rows = [heads, *(_row(row) for gait in gaits for row in agreements(gait))]
    lines = [f"{gait.name}: {gait.early_end}" for gait in gaits if gait.early_end]
    lines.append(text_table(rows))
    phases = {f"{1e3 * gait.expected.nominal.groove_phase:+.2f} mm": None for gait in gaits}
    lines += ["", f"expected without the margin, at a groove phase of {', '.join(phases)}"]
    lines += {f"intervals at 95 %: {gait.expected.condition}": None for gait in gaits}
    lines += [f"{gait.name}: {margin_text(gait)}" for gait in gaits]
    lines += [text for _, text in orders(gaits).values()]
    lines += [f"{gait.name}: {reason}" for gait in gaits for reason in gait.missing]
    return "\n".join(lines)


def margin_text(gait: RecordedGait) -> str:
    """Return the measured margins of a gait and the predicted one as text."""
    if not gait.margin.source:
        return "margins are not measured; the tracker must see both modules"
    return f"{gait.margin}; predicted {1e3 * gait.predicted_margin:.1f} mm"


def expected_range(row: Agreement) -> str:
    """Return the expected 95 % interval as text; for the speed, the expected grooves with their probabilities."""
    if row.obstacle:
        return "–"
    if row.grooves is None:
        return QUANTITIES[row.quantity].range(row.expected)
    return str(row.grooves).partition(";")[0]


def _row(row: Agreement) -> tuple[str, ...]:
    quantity = QUANTITIES[row.quantity]
    return (
        row.gait,
        quantity.title,
        quantity.text(row.measured.value),
        quantity.text(row.expected.value),
        expected_range(row),
        percent(row.difference) or "–",
        row.verdict,
    )


def agreement_json(gaits: Sequence[RecordedGait]) -> dict[str, Any]:
    """Return the comparison of measured with expected values for the machine-readable output."""
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
                "verdict": {row.quantity: row.verdict for row in agreements(gait)},
                "grooves": _grooves_json(gait),
                "missing": list(gait.missing),
                "early_end": gait.early_end,
                "averaged_cycles": list(gait.averaged_cycles),
                "idle_power": gait.idle_power,
                "margin": gait.margin.as_json(),
                "predicted_margin_m": gait.predicted_margin,
            }
            for gait in gaits
        ],
        "order_preserved": {name: preserved for name, (preserved, _) in orders(gaits).items()},
    }


def _grooves_json(gait: RecordedGait) -> dict[str, Any]:
    grooves = grooves_of(gait)
    measured = math.nan if grooves is None else grooves.measured
    return {"expected": [asdict(share) for share in gait.expected.grooves], "measured": measured}
