# SPDX-License-Identifier: Apache-2.0
"""From parameters to a robust front: margin scan, certified front, predictions; each kept on disk."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from worm_model.gait import FORWARD
from worm_model.parameters import ParameterFile, Parameters
from worm_model.simulation.simulator import cost_of_transport
from worm_optimizer.robustness.chance import (
    Evaluate,
    PromiseTask,
    WatchedTask,
    in_turn,
    margins_stood,
)
from worm_optimizer.robustness.prediction import Prediction, predict
from worm_optimizer.robustness.uncertainty import every_phase, phase_guard, phase_known
from worm_optimizer.search.cache import Cache, key_of, scan_key_of
from worm_optimizer.search.certificate import certified_front
from worm_optimizer.search.gait_map import build_map
from worm_optimizer.search.nsga2 import Generation
from worm_optimizer.search.price_of_robustness import (
    MarginPoint,
    PriceOfRobustness,
    price_of_robustness,
    scan,
)
from worm_optimizer.search.search_settings import Robustness, Settings
from worm_optimizer.search.task import Index, MarginTask, Points, Task

# Shares of the whole time, roughly, at which the stages of a front end.
_SCANNED, _SEARCHED, _DONE = 0.7, 0.85, 1.0
_MAPPED_PER_CELL = 3.0  # gaits that a map evaluates for each of its grid, roughly
_CHANCE_SCENARIOS = (
    200  # draws over which a promise is optimised; its gaits are then judged on others
)


@dataclass(frozen=True)
class Progress:
    """``fraction`` done of the whole (0 to 1) and what is being done; within the search, where it stands.

    ``hypervolume`` in m/s·W; ``generation`` is 0 outside the search.
    """

    fraction: float
    doing: str
    generation: int = 0
    generations: int = 0
    hypervolume: float = 0.0
    front_size: int = 0


Report = Callable[[Progress], None]


@dataclass(frozen=True)
class RobustFront:
    """A front with all that is predicted of its gaits, by rising speed, and where it comes from.

    ``margin`` in m with the ``reason`` for it; ``source``, ``hypervolume_share`` and ``missed_branches``
    as in `certificate.CertifiedFront`, for the whole front of which some gaits are kept here.
    """

    direction: int
    margin: float
    reason: str
    source: str
    hypervolume_share: float
    missed_branches: tuple[int, ...]
    predictions: tuple[Prediction, ...]

    def mirrored(self) -> RobustFront:
        """The same front in the other direction, for a robot with equal modules: its exact mirror image."""
        predictions = tuple(
            dataclasses.replace(gait, direction=-gait.direction) for gait in self.predictions
        )
        return dataclasses.replace(self, direction=-self.direction, predictions=predictions)

    def as_dict(self) -> dict[str, Any]:
        """The front as plain values, for a file."""
        return dataclasses.asdict(self)

    @staticmethod
    def from_dict(content: Mapping[str, Any]) -> RobustFront:
        """The inverse of `as_dict`; raises TypeError, KeyError or ValueError on anything else."""
        values = dict(content)
        values["missed_branches"] = tuple(int(n) for n in values["missed_branches"])
        values["predictions"] = tuple(Prediction(**row) for row in values["predictions"])
        return RobustFront(**values)


def task_of(content: ParameterFile, settings: Settings, direction: int) -> MarginTask:
    """The optimisation task of these settings, without a margin yet."""
    return MarginTask(content.parameters, direction, bounds=settings.bounds, limits=settings.limits)


def scanned_price(
    content: ParameterFile, settings: Settings, direction: int, cache: Cache, report: Report
) -> PriceOfRobustness:
    """The margin scan of these settings, from the cache or computed and then stored there."""
    direction = _canonical(direction, content.parameters)
    name = f"scan-{scan_key_of(content, settings, direction)}"
    points = cache.load(name, _points_of)
    if points is None:
        points = []
        margins = settings.scan.margins()
        for point in scan(task_of(content, settings, direction), settings.map, margins):
            points.append(point)
            report(Progress(len(points) / margins.size, f"margin {1e3 * point.margin:.2f} mm"))
        cache.store(name, [dataclasses.asdict(point) for point in points])
    return price_of_robustness(points, content.parameters)


def is_symmetric(parameters: Parameters) -> bool:
    """Whether either direction is the exact mirror image of the other: it is with equal modules."""
    p = parameters
    return (p.rear_mass, p.rear_dry_friction) == (p.front_mass, p.front_dry_friction)


def both_ways(front: RobustFront, parameters: Parameters) -> tuple[RobustFront, ...]:
    """A front, and that of the other direction where it is the mirror image."""
    return (front, front.mirrored()) if is_symmetric(parameters) else (front,)


def _canonical(direction: int, parameters: Parameters) -> int:
    """The direction to compute: forward serves both of a symmetric robot."""
    return FORWARD if is_symmetric(parameters) else direction


def _points_of(rows: list[dict[str, Any]]) -> list[MarginPoint]:
    return [MarginPoint(**{**row, "branches": tuple(row["branches"])}) for row in rows]


def load_front(
    content: ParameterFile, settings: Settings, direction: int, cache: Cache
) -> RobustFront | None:
    """The front of these settings if it is in the cache."""
    return cache.load(_front_name(content, settings, direction), RobustFront.from_dict)


def load_current(
    content: ParameterFile, settings: Settings, direction: int, cache: Cache
) -> RobustFront | None:
    """The front that answered requests last under these settings, else their own, if it is in the cache."""
    current = cache.load(_current_name(content, settings, direction), RobustFront.from_dict)
    return current or load_front(content, settings, direction, cache)


def store_current(
    content: ParameterFile, settings: Settings, front: RobustFront, cache: Cache
) -> None:
    """Keeps a front, of whatever settings of its own, as the one that answers requests under these."""
    cache.store(_current_name(content, settings, front.direction), front.as_dict())


def _current_name(content: ParameterFile, settings: Settings, direction: int) -> str:
    return f"current-{key_of(content, settings, direction)}"


def _front_name(content: ParameterFile, settings: Settings, direction: int) -> str:
    return f"front-{key_of(content, settings, direction)}"


def make_front(
    content: ParameterFile,
    settings: Settings,
    direction: int,
    cache: Cache,
    report: Report,
    evaluate: Evaluate = in_turn,
) -> RobustFront:
    """Computes the front of these settings and stores it in the cache, with its mirror image if it has one.

    ``evaluate`` judges the gaits of a promise, which is the long work of such a front. Raises `OptimizerError` if no
    gait moves, OSError if the cache cannot be written.
    """
    canonical = _canonical(direction, content.parameters)
    computed = _computed_front(content, settings, canonical, cache, report, evaluate)
    fronts = both_ways(computed, content.parameters)
    for front in fronts:
        cache.store(_front_name(content, settings, front.direction), front.as_dict())
    return next(front for front in fronts if front.direction == direction)


def _computed_front(
    content: ParameterFile,
    settings: Settings,
    direction: int,
    cache: Cache,
    report: Report,
    evaluate: Evaluate,
) -> RobustFront:
    report = _rising(report)
    task, margin, reason = _robust_task(content, settings, direction, cache, report)
    start = _SCANNED if _scans(settings) else 0.0
    if settings.robustness is not Robustness.MARGIN:
        task, start = _watched(task, settings, report, evaluate)

    def searched(generation: Generation) -> None:
        done = start + (_SEARCHED - start) * generation.number / generation.of
        size, volume = len(generation.front), generation.hypervolume
        doing = f"generation {generation.number} of {generation.of}"
        report(Progress(done, doing, generation.number, generation.of, volume, size))

    certified = certified_front(task, settings.search, settings.map, searched)
    report(Progress(_SEARCHED, "success probabilities"))
    nominal = task_of(content, settings, direction)
    kept = certified.front.take(thinned(certified.front, content.parameters, settings.kept_gaits))
    margins = np.full(len(kept), margin)
    if settings.robustness is not Robustness.MARGIN:
        margins = margins_stood(nominal, kept)
        margin = float(margins.min())
        reason += f"; it amounts to margins from {1e3 * margin:.2f} to {1e3 * margins.max():.2f} mm"
    gaits = kept.stroke, kept.frequency, margins
    predictions = predict(nominal, content, *gaits, settings.samples, settings.search.seed)
    report(Progress(_DONE, "done"))
    return RobustFront(
        direction=direction,
        margin=margin,
        reason=reason,
        source=certified.source,
        hypervolume_share=certified.hypervolume_share,
        missed_branches=certified.missed_branches,
        predictions=predictions,
    )


def _robust_task(
    content: ParameterFile, settings: Settings, direction: int, cache: Cache, report: Report
) -> tuple[Task, float, str]:
    """The task to search, its margin in m and the reason for it in words."""
    task = task_of(content, settings, direction)
    match settings.robustness:
        case Robustness.CHANCE:
            # A seed of its own: probabilities told of the chosen gaits must not come from these draws.
            scenarios = phase_known(content, _CHANCE_SCENARIOS, settings.search.seed + 1)
            promise = PromiseTask(task, scenarios, settings.probability)
            return promise, 0.0, f"its grooves are kept with probability {settings.probability:g}"
        case Robustness.ANY_PHASE:
            guarded = task.with_margin(phase_guard(content.parameters))
            promise = PromiseTask(guarded, every_phase(content.parameters), 1.0)
            return promise, 0.0, "its grooves are kept at every groove phase"
    if settings.margin is not None:
        return task.with_margin(settings.margin), settings.margin, "given"

    def scanned(progress: Progress) -> None:
        report(Progress(_SCANNED * progress.fraction, progress.doing))

    price = scanned_price(content, settings, direction, cache, scanned)
    return task.with_margin(price.margin), price.margin, reason_for(price)


def _watched(
    task: Task, settings: Settings, report: Report, evaluate: Evaluate
) -> tuple[Task, float]:
    """A task that reports while its map is built, and the fraction at which its search begins."""
    mapped = _MAPPED_PER_CELL * settings.map.strokes * settings.map.frequencies
    searched = settings.search.population * settings.search.generations
    start = _SEARCHED * mapped / (mapped + searched)
    count = 0

    def judged(gaits: int) -> None:
        nonlocal count
        count += gaits
        report(Progress(min(start * count / mapped, start), f"{count} gaits judged"))

    return WatchedTask(task, judged, evaluate), start


def _rising(report: Report) -> Report:
    """A report whose fraction never falls."""
    reached = 0.0

    def report_rising(progress: Progress) -> None:
        nonlocal reached
        reached = max(reached, progress.fraction)
        report(dataclasses.replace(progress, fraction=reached))

    return report_rising


def _scans(settings: Settings) -> bool:
    """Whether the margin is to be chosen by a scan."""
    return settings.robustness is Robustness.MARGIN and settings.margin is None


def reason_for(price: PriceOfRobustness) -> str:
    """Why a scan's margin was chosen, in words."""
    if price.cliff is None:
        return "the greatest margin of the scan at which a gait moves: the scan has no cliff"
    rise = (
        "no gait moves" if np.isinf(price.cliff.rise) else f"{price.cliff.rise:.2f} times the cost"
    )
    return (
        f"at the cliff: beyond it the branch with {price.cliff.lost_branch} grooves a cycle is lost and "
        f"travel is {rise}; in closed form it lies at {1e3 * price.closed_form_cliff_margin:.2f} mm"
    )


def thinned(front: Points, parameters: Parameters, count: int) -> Index:
    """Rows of at most ``count`` gaits of a front, evenly over its speeds, its ends and lowest COT kept."""
    if len(front) <= count:
        return np.arange(len(front))
    best = int(np.argmin(cost_of_transport(front.speed, front.power, parameters.mass)))
    wanted = np.linspace(front.speed[0], front.speed[-1], count - 1)
    rows = np.searchsorted(front.speed, wanted)
    return np.unique(np.append(rows, best))


def nominal_gaits(
    content: ParameterFile, settings: Settings, direction: int
) -> dict[str, Prediction]:
    """The three gaits of the true front without any margin, by name; none if no gait moves."""
    task = task_of(content, settings, direction)
    front = build_map(task, settings.map).front
    if not len(front):
        return {}
    cost = cost_of_transport(front.speed, front.power, content.parameters.mass)
    rows = [int(np.argmin(front.power)), int(np.argmin(cost)), int(np.argmax(front.speed))]
    gaits = front.stroke[rows], front.frequency[rows], np.zeros(len(rows))
    predictions = predict(task, content, *gaits, settings.samples, settings.search.seed)
    return dict(zip(("min_power", "cruise", "max_speed"), predictions, strict=True))
