# SPDX-License-Identifier: Apache-2.0
"""Front for recorded gaits: for their parameters, their direction and the margin they were designed with."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from worm_model.gait import GAIT_DEFAULTS, WAVEFORM, Gait
from worm_optimizer.report.recorded_gait import RecordedGait
from worm_optimizer.search.front import RobustFront, make_front, reason_for, scanned_price
from worm_optimizer.search.price_of_robustness import PriceOfRobustness
from worm_optimizer.search.search_settings import Settings

_SAME_MARGIN = 1e-7  # m


@dataclass(frozen=True)
class Optimisation:
    """Result of the optimizer for the parameters that the gaits are compared with.

    Attributes:
        front: robust front.
        price: price of robustness.
        note: which gaits the front applies to if their margins or waveforms differ; else empty.
    """

    front: RobustFront
    price: PriceOfRobustness
    note: str = ""


def why_no_front(gaits: Sequence[RecordedGait]) -> str:
    """Return why the gaits cannot be shown on one front, or an empty string if they can."""
    if len({gait.gait.direction for gait in gaits}) > 1:
        return "no front is shown: the gaits go in different directions; report each direction by itself"
    first = gaits[0].content
    for gait in gaits[1:]:
        other = gait.content
        if (other.parameters, other.intervals) != (first.parameters, first.intervals):
            return (
                f"no front is shown: {gaits[0].name} and {gait.name} were recorded with different parameters; "
                "give --parameters FILE for all of them"
            )
    return ""


def sinusoid_of(gait: Gait) -> Gait:
    """Return the gait with the paper's waveform, of the same stroke and frequency."""
    shaping = {name: GAIT_DEFAULTS[name] for name in WAVEFORM if name in GAIT_DEFAULTS}
    return replace(gait, **shaping)


def optimise(gaits: Sequence[RecordedGait]) -> Optimisation:
    """Return front and price of robustness for gaits that `why_no_front` accepts.

    The front has the margin of the gaits. If their margins differ, it has the margin of the cliff.

    Raises:
        OptimizerError: No gait moves the robot.
    """
    content, direction = gaits[0].content, gaits[0].gait.direction
    price = scanned_price(content, Settings(), direction)
    margins = sorted({gait.gait.margin for gait in gaits})
    notes, margin = [], margins[0]
    if margins[-1] - margins[0] > _SAME_MARGIN:
        low, high = 1e3 * margins[0], 1e3 * margins[-1]
        margin = price.margin
        notes.append(
            f"The gaits were made with margins from {low:.2f} to {high:.2f} mm; the front is that of the margin "
            "at the cliff."
        )
    if any(gait.gait != sinusoid_of(gait.gait) for gait in gaits):
        notes.append("The front is that of the paper's waveform; some gaits are shaped.")
    front = make_front(content, Settings(margin=margin), direction)
    if math.isclose(margin, price.margin, abs_tol=_SAME_MARGIN):
        front = replace(front, reason=reason_for(price))
    return Optimisation(front, price, " ".join(notes))
