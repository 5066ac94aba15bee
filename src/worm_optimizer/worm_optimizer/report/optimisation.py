# SPDX-License-Identifier: Apache-2.0
"""Front for recorded gaits, computed with their parameters, their direction and the margin of their design."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from worm_msgs.gait import GAIT_DEFAULTS, WAVEFORM, Gait
from worm_optimizer.report.recorded_gait import RecordedGait
from worm_optimizer.search.front import RobustFront, make_front, reason_for, scanned_price
from worm_optimizer.search.price_of_robustness import PriceOfRobustness
from worm_optimizer.search.search_settings import Settings

_SAME_MARGIN = 1e-7  # margins that differ by less count as equal, m


@dataclass(frozen=True)
class Optimisation:
    """Result of the optimizer for the parameters with which the gaits are compared.

    Attributes:
        front: robust front.
        price: price of robustness.
        note: difference between the front and the gaits in margin or waveform, as text; empty without a difference.
    """

    front: RobustFront
    price: PriceOfRobustness
    note: str = ""


def why_no_front(gaits: Sequence[RecordedGait]) -> str:
    """Return the reason why the gaits cannot be shown on one front; empty if they can."""
    if len({gait.gait.direction for gait in gaits}) > 1:
        return "no front is shown: the gaits have different directions; make a report for each direction"
    first = gaits[0].content
    for gait in gaits[1:]:
        other = gait.content
        if (other.parameters, other.intervals) != (first.parameters, first.intervals):
            return (
                f"no front is shown: {gaits[0].name} and {gait.name} were recorded with different parameters; "
                "give one parameter file for all recordings with --parameters FILE"
            )
    return ""


def sinusoid_of(gait: Gait) -> Gait:
    """Return a gait with the paper's waveform and otherwise the values of ``gait``."""
    shaping = {name: GAIT_DEFAULTS[name] for name in WAVEFORM if name in GAIT_DEFAULTS}
    return replace(gait, **shaping)


def optimise(gaits: Sequence[RecordedGait]) -> Optimisation:
    """Return front and price of robustness for gaits for which `why_no_front` returns an empty text.

    The front has the margin of the gaits. If their margins differ, it has the last margin of the scan before the cliff.
    """
    content, direction = gaits[0].content, gaits[0].gait.direction
    price = scanned_price(content, Settings(), direction)
    margins = sorted({gait.gait.margin for gait in gaits})
    notes, margin = [], margins[0]
    if margins[-1] - margins[0] > _SAME_MARGIN:
        low, high = 1e3 * margins[0], 1e3 * margins[-1]
        margin = price.margin
        notes.append(
            f"The gaits were designed with margins from {low:.2f} to {high:.2f} mm; the front has the last margin "
            "before the cliff."
        )
    if any(gait.gait != sinusoid_of(gait.gait) for gait in gaits):
        notes.append("Some gaits are shaped; the front contains the paper's waveform only.")
    front = make_front(content, Settings(margin=margin), direction)
    if math.isclose(margin, price.margin, abs_tol=_SAME_MARGIN):
        front = replace(front, reason=reason_for(price))
    return Optimisation(front, price, " ".join(notes))
