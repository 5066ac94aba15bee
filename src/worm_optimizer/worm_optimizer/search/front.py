# SPDX-License-Identifier: Apache-2.0
"""Robust front of a robot: choice of the margin, exact front, and predictions of its gaits."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import assert_never

import numpy as np

from worm_model.errors import InputError
from worm_model.gait import Gait
from worm_model.loads import content_under
from worm_model.parameters import ParameterFile, Parameters
from worm_model.simulation.simulator import LoadError, cost_of_transport, evaluate_gait
from worm_optimizer.evaluation.actuator_limits import NO_LIMITS, describe_limit, peaks
from worm_optimizer.evaluation.command_shape import shapes_of_gaits
from worm_optimizer.evaluation.task import Array, Index, MarginTask, Points, Task
from worm_optimizer.gait_prediction import Prediction
from worm_optimizer.robustness.chance import PromiseTask, tolerated_margins
from worm_optimizer.robustness.prediction import outline, predict
from worm_optimizer.robustness.uncertainty import (
    every_phase,
    phase_guard,
    phase_known,
    travel_described,
)
from worm_optimizer.search.exact import ExactFront, Resolution, Zoom, exact_front
from worm_optimizer.search.price_of_robustness import PriceOfRobustness, price_of_robustness
from worm_optimizer.search.search_settings import Robustness, Settings, Waveform
from worm_optimizer.search.shaped import ShapedTask

THREE = ("min_power", "cruise", "max_speed")  # names of the paper's three gaits
_THIN_MARGIN = 1e-3  # m; robots differ from the model by more, see `worm_model.travel_error.PRIOR`
_LOW_SUCCESS = 0.9
# N. With the robots of `worm_model.travel_error.PRIOR`, gaits for 95 % were kept by 92 % where the model pushes with
# 20 N (0.22 Hz), 88 % with 23 N, 54 % with 27 N and 13 % with 31 N (0.3 Hz).
_MOST_PUSH = 20.0
_CHANCE_SCENARIOS = 200  # draws of the parameters in the search with Robustness.CHANCE
# Largest number of frequencies in the survey of a task whose edges take long to compute
_COLUMNS = {PromiseTask: 41, ShapedTask: 81}


@dataclass(frozen=True)
class RobustFront:
    """Front with the predictions of its gaits, and the data from which requests are answered.

    Attributes:
        margin: robustness margin, m. With `Robustness.CHANCE` and `Robustness.ANY_PHASE`, the smallest of the margins
            that the gaits tolerate.
        reason: reason for the margin, as text.
        exact: exact front.
        gaits: predictions of the gaits of the front, by rising speed, without distances to edges and without
            probabilities (`outline`).
        three: complete predictions of the paper's three gaits, by name (`THREE`).
        nominal: task without a margin.
        content: parameters of the robot under the conditions of the settings.
        settings: settings of the optimisation.
    """

    margin: float
    reason: str
    exact: ExactFront
    gaits: tuple[Prediction, ...]
    three: dict[str, Prediction]
    nominal: MarginTask
    content: ParameterFile
    settings: Settings

    @property
    def direction(self) -> int:
        """Direction of all gaits."""
        return self.nominal.direction

    @property
    def described(self) -> str:
        """Margin with its reason, and the condition under which the success probabilities hold, as text."""
        condition = travel_described(self.content)
        return f"margin {1e3 * self.margin:.2f} mm, {self.reason}; success: {condition}"

    def warning(self, gaits: Iterable[Prediction]) -> str:
        """Return the warnings about gaits of the front with complete predictions, as text; empty without any."""
        chosen = list(gaits)
        success = min(gait.success_probability for gait in chosen)
        warnings = (
            thin_margin_warning(self.settings.robustness, self.margin, success),
            pushing_warning(chosen, self.content.parameters),
        )
        return "; ".join(filter(None, warnings))

    def predicted(self, points: Points) -> tuple[Prediction, ...]:
        """Predict gaits of the front with all fields of `Prediction`."""
        margins = _margins(self.nominal, self.settings, self.margin, points)
        return _predicted(self.nominal, self.content, self.settings, points, margins)


def thin_margin_warning(robustness: Robustness, margin: float, success: float = 1.0) -> str:
    """Return a warning if gaits with a margin (m) or a success probability probably lose grooves; empty if not.

    The default margin is between 0.3 and 8 mm, depending on the groove phase alone.
    """
    reasons = {
        f"the margin is only {1e3 * margin:.2f} mm": margin < _THIN_MARGIN,
        f"the success probability is only {success:.2f}": success < _LOW_SUCCESS,
    }
    found = " and ".join(reason for reason, holds in reasons.items() if holds)
    if not found:
        return ""
    any_phase = (
        "" if robustness is Robustness.ANY_PHASE else "search with robustness any_phase, or "
    )
    return f"{found}: {any_phase}measure the margin on the robot and adapt the gait (tune)"


def pushing_warning(gaits: Sequence[Gait], parameters: Parameters) -> str:
    """Return a warning if gaits of one direction need a cable that pushes; empty if not.

    No travel error describes a body that the bellows extends too slowly (see `_MOST_PUSH`).
    """
    stroke, frequency = (
        np.array([getattr(g, name) for g in gaits]) for name in ("stroke", "frequency")
    )
    push = peaks(
        stroke, frequency, gaits[0].direction, parameters, shape=shapes_of_gaits(gaits)
    ).push
    worst = int(np.argmax(push))
    if not push[worst] > _MOST_PUSH:
        return ""
    return (
        f"at {frequency[worst]:.3f} Hz the cable pushes with {push[worst]:.0f} N in the model, which no cable can, so "
        "the success probability does not hold: choose a lower frequency, or bound this force (max_push_force)"
    )


def price_warning(price: PriceOfRobustness) -> str:
    """Return `thin_margin_warning` of the margin that a scan chooses."""
    return thin_margin_warning(Robustness.MARGIN, price.margin) if price.moves else ""


def task_of(content: ParameterFile, settings: Settings, direction: int) -> MarginTask:
    """Return the task of some settings without a margin. ``content`` must include the conditions in the pipe."""
    return MarginTask(content.parameters, direction, bounds=settings.bounds, limits=settings.limits)


def waveform_task(task: MarginTask, settings: Settings) -> MarginTask | ShapedTask:
    """Return the task that searches among the gaits of the chosen waveform."""
    if settings.waveform is Waveform.SHAPED:
        return ShapedTask(task, settings.shapes)
    return task


def scanned_price(content: ParameterFile, settings: Settings, direction: int) -> PriceOfRobustness:
    """Return the price of robustness for some settings, under the conditions in these settings."""
    return price_of(
        task_of(content_under(settings.conditions, content), settings, direction), settings
    )


def price_of(task: MarginTask, settings: Settings) -> PriceOfRobustness:
    """Return the price of robustness of a task among the gaits of the chosen waveform.

    The margin of the task has no effect, because the settings contain the margins of the scan.
    """
    margins = settings.scan.margins()
    if settings.waveform is Waveform.SHAPED:
        over = ShapedTask.over_margins(task, settings.shapes, margins)
        return price_of_robustness(over, margins)
    return price_of_robustness(task, margins)


def make_front(content: ParameterFile, settings: Settings, direction: int) -> RobustFront:
    """Compute the front for some settings. Raises `InputError` if no gait moves within the limits."""
    content = content_under(settings.conditions, content)
    nominal = task_of(content, settings, direction)
    task, margin, reason = _robust_task(nominal, content, settings)
    exact = front_of_task(task, settings.resolution)
    if not len(exact.front):
        raise InputError(_why_nothing_moves(task, settings.resolution))
    margins = _margins(nominal, settings, margin, exact.front)
    if isinstance(task, PromiseTask):
        margin = float(margins.min())
        most = 1e3 * margins.max()
        reason += f"; equivalent margins are {1e3 * margin:.2f} to {most:.2f} mm"
    return RobustFront(
        margin=margin,
        reason=reason,
        exact=exact,
        gaits=outline(
            nominal, exact.front.stroke, exact.front.frequency, margins, exact.front.shape
        ),
        three=_three(nominal, content, settings, exact.front, margins),
        nominal=nominal,
        content=content,
        settings=settings,
    )


def front_of_task(task: Task, resolution: Resolution) -> ExactFront:
    """Compute the exact front of a task, at fewer frequencies if the edges of the task take long to compute."""
    columns = _COLUMNS.get(type(task))
    if columns is None:
        return exact_front(task, resolution, Zoom())
    frequencies = min(resolution.frequencies, columns)
    fewer = dataclasses.replace(resolution, frequencies=frequencies)
    return exact_front(task, fewer, Zoom(points=9, rounds=6))


def replaced(front: RobustFront, gaits: Points) -> RobustFront:
    """Return a front in which ``gaits`` replace the exact gaits.

    ``gaits`` contains at least one gait of the same task, by rising speed.
    """
    margins = _margins(front.nominal, front.settings, front.margin, gaits)
    return dataclasses.replace(
        front,
        gaits=outline(front.nominal, gaits.stroke, gaits.frequency, margins, gaits.shape),
        three=_three(front.nominal, front.content, front.settings, gaits, margins),
    )


def _margins(nominal: MarginTask, settings: Settings, margin: float, points: Points) -> Array:
    """Return the margin of each gait in m.

    With `Robustness.MARGIN` it is the margin of the front, otherwise the largest margin at which the gait keeps its
    grooves.
    """
    if settings.robustness is Robustness.MARGIN:
        return np.full(len(points), margin)
    return tolerated_margins(nominal, points)


def _predicted(
    nominal: MarginTask, content: ParameterFile, settings: Settings, points: Points, margins: Array
) -> tuple[Prediction, ...]:
    gaits = points.stroke, points.frequency, margins
    return predict(nominal, content, *gaits, settings.samples, settings.seed, points.shape)


def _three(
    nominal: MarginTask, content: ParameterFile, settings: Settings, front: Points, margins: Array
) -> dict[str, Prediction]:
    """Return the complete predictions of a front's three gaits by name; ``margins`` (n,) in m."""
    rows = three_rows(front, content.parameters)
    gaits = _predicted(nominal, content, settings, front.take(rows), margins[rows])
    return dict(zip(THREE, gaits, strict=True))


def three_rows(front: Points, parameters: Parameters) -> Index:
    """Return the rows of a front's gaits of lowest power, lowest cost of transport and highest speed."""
    cost = cost_of_transport(front.speed, front.power, parameters.mass)
    return np.array([np.argmin(front.power), np.argmin(cost), len(front) - 1])


def _robust_task(
    nominal: MarginTask, content: ParameterFile, settings: Settings
) -> tuple[MarginTask | ShapedTask | PromiseTask, float, str]:
    """Return the task to search, its margin in m and the reason for it as text."""
    match settings.robustness:
        case Robustness.CHANCE:
            # Another seed, so that the predicted success probabilities come from other draws than the search.
            scenarios = phase_known(content, _CHANCE_SCENARIOS, settings.seed + 1)
            promise = PromiseTask(nominal, scenarios, settings.probability)
            return (
                promise,
                0.0,
                f"gaits keep their grooves with probability {settings.probability:g}",
            )
        case Robustness.ANY_PHASE:
            return any_phase_task(nominal), 0.0, "gaits keep their grooves at every groove phase"
        case Robustness.MARGIN:
            return _margin_task(nominal, settings)
        case _:
            assert_never(settings.robustness)


def _margin_task(
    nominal: MarginTask, settings: Settings
) -> tuple[MarginTask | ShapedTask, float, str]:
    """Return the task with the margin that is given, or that the price of robustness determines."""
    given = given_margin(nominal.parameters, settings)
    if given is not None:
        margin, reason = given
        return waveform_task(nominal.with_margin(margin), settings), margin, reason
    price = price_of(nominal, settings)
    if not price.moves:
        least = waveform_task(nominal.with_margin(settings.scan.lowest), settings)
        raise InputError(_why_nothing_moves(least, settings.resolution))
    task = waveform_task(nominal.with_margin(price.margin), settings)
    return task, price.margin, reason_for(price)


def given_margin(parameters: Parameters, settings: Settings) -> tuple[float, str] | None:
    """Return the margin in m that the settings contain, and the reason for it; None if they contain no margin."""
    if settings.margin is not None:
        return settings.margin, "given"
    if settings.margin_force is None:
        return None
    # For slow gaits, whose viscous friction is negligible, a load Q makes the travel from threshold to threshold longer
    # by Q/k_eng. A margin δ_m makes it longer by δ_m·(1 + k_dis/k_eng). Both are equal for δ_m = Q/(k_eng + k_dis).
    stiffness = parameters.engaged_stiffness + parameters.disengaged_stiffness
    return settings.margin_force / stiffness, f"for a load of {settings.margin_force:g} N"


def any_phase_task(nominal: MarginTask) -> PromiseTask:
    """Return the task whose gaits keep their grooves at every groove phase."""
    guarded = nominal.with_margin(phase_guard(nominal.parameters))
    return PromiseTask(guarded, every_phase(nominal.parameters), 1.0)


def _why_nothing_moves(task: MarginTask | ShapedTask | PromiseTask, resolution: Resolution) -> str:
    """Return the reason why the front of a task is empty: no gait moves, or a limit excludes all gaits that move."""
    robot = task if isinstance(task, MarginTask) else task.task
    free = dataclasses.replace(robot, limits=NO_LIMITS)
    unlimited = free if isinstance(task, MarginTask) else dataclasses.replace(task, task=free)
    moving = front_of_task(unlimited, resolution).surveyed.points
    if not len(moving):
        longest = Gait(robot.bounds.stroke_high, robot.bounds.frequency_low, robot.direction)
        try:
            evaluate_gait(longest, robot.parameters)
        except LoadError as error:
            return str(error)
        return (
            "no gait within the bounds gains a groove in every cycle: "
            "lower the margin or the probability, or allow longer strokes"
        )
    return describe_limit(
        robot.limits,
        moving.stroke,
        moving.frequency,
        robot.direction,
        robot.parameters,
        moving.shape,
    )


def reason_for(price: PriceOfRobustness) -> str:
    """Return the reason why a scan's margin was chosen, as text."""
    if price.cliff is None:
        return "the largest margin of the scan at which a gait moves: the scan has no cliff"
    return (
        f"the last margin of the scan before the cliff at {1e3 * price.cliff.margin:.3f} mm, where "
        f"{price.cliff.consequence}; the closed form of the cliff is {1e3 * price.closed_form_cliff_margin:.3f} mm"
    )


def thinned(front: Points, parameters: Parameters, count: int) -> Index:
    """Return at most ``count`` rows of a front at evenly spaced speeds, and among them the rows of `three_rows`."""
    if len(front) <= count:
        return np.arange(len(front))
    wanted = np.linspace(front.speed[0], front.speed[-1], count - 1)
    rows = np.clip(np.searchsorted(front.speed, wanted), 0, len(front) - 1)
    return np.unique(np.append(rows, three_rows(front, parameters)[1]))


def nominal_gaits(
    content: ParameterFile, settings: Settings, direction: int
) -> dict[str, Prediction]:
    """Return the paper's three gaits of the exact front without a margin, by name; empty if no gait moves."""
    content = content_under(settings.conditions, content)
    task = task_of(content, settings, direction)
    front = front_of_task(waveform_task(task, settings), settings.resolution).front
    if not len(front):
        return {}
    return _three(task, content, settings, front, np.zeros(len(front)))


def predicted_gaits(
    gaits: Mapping[str, Gait], content: ParameterFile, settings: Settings
) -> dict[str, Prediction]:
    """Predict given gaits of one direction, each with its own margin, under the conditions of the settings."""
    content = content_under(settings.conditions, content)
    stroke, frequency, margin = (
        np.array([getattr(gait, name) for gait in gaits.values()])
        for name in ("stroke", "frequency", "margin")
    )
    (direction,) = {gait.direction for gait in gaits.values()}
    task = task_of(content, settings, direction)
    drawn = settings.samples, settings.seed
    predictions = predict(
        task, content, stroke, frequency, margin, *drawn, shapes_of_gaits(gaits.values())
    )
    return dict(zip(gaits, predictions, strict=True))


def given_gait(gait: Gait, content: ParameterFile, settings: Settings) -> tuple[Prediction, str]:
    """Predict a gait with its own margin, under the conditions of the settings; return warnings as text, too."""
    parameters = content_under(settings.conditions, content).parameters
    evaluate_gait(gait, parameters)
    prediction = predicted_gaits({"given": gait}, content, settings)["given"]
    warnings = (
        thin_margin_warning(settings.robustness, math.inf, prediction.success_probability),
        pushing_warning([gait], parameters),
    )
    return prediction, "; ".join(filter(None, warnings))
