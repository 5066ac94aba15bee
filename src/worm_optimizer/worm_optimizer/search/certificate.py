# SPDX-License-Identifier: Apache-2.0
"""NSGA-II beside the exhaustive map: how much of the true front it reached, and the better of both."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from worm_optimizer.search.gait_map import GaitMap, MapSettings, branches_of, build_map
from worm_optimizer.search.nsga2 import Generation, SearchSettings, generations
from worm_optimizer.search.optimizer_errors import OptimizerError
from worm_optimizer.search.pareto import hypervolume
from worm_optimizer.search.task import Points, Task

REQUIRED_SHARE = 0.995  # of the map's hypervolume, below which the better front is taken
NSGA2, MAP = "nsga2", "map"

# The hypervolume's corner is standing still at a tenth more than the highest power of the true front:
# with the highest power itself, the fastest gait would count nothing.
_CORNER = 1.1


@dataclass(frozen=True)
class CertifiedFront:
    """The better front and what NSGA-II's is worth.

    ``front`` by rising speed is that of ``source`` (NSGA2 or MAP); ``hypervolume_share`` is NSGA-II's
    hypervolume over the map's, both from the corner (0 m/s, ``reference_power`` W), and can exceed 1 by
    the map's resolution; ``missed_branches`` are grooves per cycle that the map's front has and
    NSGA-II's lacks.
    """

    front: Points
    source: str
    hypervolume: float
    hypervolume_share: float
    missed_branches: tuple[int, ...]
    reference_power: float
    gait_map: GaitMap


def certified_front(
    task: Task,
    search: SearchSettings,
    resolution: MapSettings,
    report: Callable[[Generation], None],
) -> CertifiedFront:
    """Maps the box, runs NSGA-II, and takes NSGA-II's front, or the map's if that falls short.

    ``report`` is called after each generation. Raises `OptimizerError` if no gait of the box moves.
    """
    gait_map = build_map(task, resolution)
    if not len(gait_map.front):
        raise OptimizerError(
            "no gait within the bounds gains a groove in every cycle and keeps the limits: "
            "lower the margin, relax the limits or allow longer strokes"
        )
    reference_power = _CORNER * float(gait_map.front.power.max())
    true_hypervolume = hypervolume(gait_map.front, reference_power)
    for generation in generations(task, search, reference_power):
        report(generation)
    share = generation.hypervolume / true_hypervolume
    missed = sorted(set(gait_map.branches) - set(branches_of(generation.front)))
    nsga2_suffices = share >= max(REQUIRED_SHARE, 1.0 if missed else 0.0)
    return CertifiedFront(
        front=generation.front if nsga2_suffices else gait_map.front,
        source=NSGA2 if nsga2_suffices else MAP,
        hypervolume=generation.hypervolume,
        hypervolume_share=share,
        missed_branches=tuple(missed),
        reference_power=reference_power,
        gait_map=gait_map,
    )
