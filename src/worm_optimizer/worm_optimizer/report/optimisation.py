# SPDX-License-Identifier: Apache-2.0
"""The front that belongs to recorded gaits: of their parameters, their direction and the margin they were made with."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from worm_optimizer.report.recorded_gait import RecordedGait
from worm_optimizer.search.cache import Cache
from worm_optimizer.search.front import Report, RobustFront, load_front, make_front, scanned_price
from worm_optimizer.search.price_of_robustness import PriceOfRobustness
from worm_optimizer.search.search_settings import Settings

_SAME_MARGIN = 1e-7  # m


@dataclass(frozen=True)
class Optimisation:
    """What the optimizer says of the parameters that the gaits are compared with.

    ``note`` says where the front is not that of all gaits, else it is empty.
    """

    front: RobustFront
    price: PriceOfRobustness
    note: str = ""


def why_no_front(gaits: Sequence[RecordedGait]) -> str:
    """Why gaits cannot be shown on one front; empty where they can."""
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


def optimise(gaits: Sequence[RecordedGait], cache: Cache, report: Report) -> Optimisation:
    """Front and price of robustness for gaits that `why_no_front` has nothing against; from the cache if there.

    The front has the margin that the gaits were made with; where they differ, that of the cliff. Raises
    `OptimizerError` if no gait moves.
    """
    content, direction = gaits[0].content, gaits[0].gait.direction
    price = scanned_price(content, Settings(), direction, cache, report)
    margins = sorted({gait.gait.margin for gait in gaits})
    note = ""
    if margins[-1] - margins[0] > _SAME_MARGIN:
        low, high = 1e3 * margins[0], 1e3 * margins[-1]
        note = (
            f"The gaits were made with margins from {low:.2f} to {high:.2f} mm; the front is that of the margin "
            "at the cliff."
        )
    settings = Settings(margin=None if note else _front_margin(margins[0], price))
    front = load_front(content, settings, direction, cache)
    if front is None:
        front = make_front(content, settings, direction, cache, report)
    return Optimisation(front, price, note)


def _front_margin(margin: float, price: PriceOfRobustness) -> float | None:
    """A margin as settings have it: None at the cliff, whose front is more likely to be there already."""
    cliff = price.cliff
    if cliff is not None and math.isclose(margin, cliff.margin, abs_tol=_SAME_MARGIN):
        return None
    return margin
