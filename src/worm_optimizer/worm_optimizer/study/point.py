# SPDX-License-Identifier: Apache-2.0
"""Computation of the results of one point of a study."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from worm_model.errors import InputError
from worm_model.loads import content_under
from worm_model.parameters import KEYS, ParameterFile, Parameters
from worm_model.simulation.closed_form import cliff_margin, front_groove, groove_phase
from worm_model.simulation.simulator import SimulationError, cost_of_transport
from worm_msgs.conditions import CONDITION_ROWS, Conditions
from worm_msgs.gait import FORWARD, GAIT_MEANINGS, GAIT_UNITS
from worm_optimizer.evaluation.actuator_limits import ActuatorLimits
from worm_optimizer.evaluation.command_shape import SHAPE_ROW, Shapes, shapes_of
from worm_optimizer.evaluation.servo_limits import limits_of, servo_model
from worm_optimizer.evaluation.task import Bounds, MarginTask, Points
from worm_optimizer.robustness.success_probability import success_probability
from worm_optimizer.robustness.uncertainty import phase_known, phase_unknown
from worm_optimizer.search.corners import ShapeBounds
from worm_optimizer.search.exact import (
    Cost,
    ExactFront,
    power_cost,
    speed_cost,
    transport_cost,
)
from worm_optimizer.search.front import (
    any_phase_task,
    front_of_task,
    price_of,
    thinned,
    waveform_task,
)
from worm_optimizer.search.gait_request import Objective, at_power, at_speed
from worm_optimizer.search.pareto import hypervolume
from worm_optimizer.search.price_of_robustness import PriceOfRobustness
from worm_optimizer.search.search_settings import Settings, Waveform
from worm_optimizer.study.plan import LIMITS, PARAMETER_FILE, SHAPE_BOUNDS, Array, Study

FRONT, GAIT, SCAN = "front_gait", "gait", "scan_margin"  # dimensions of the results of one point
DONE, FAILED = 1, 2  # values of the variable "state"
# Default reference power of hypervolumes, W; more than the fastest gait of the paper's robot needs.
REFERENCE_POWER = 20.0
THREE_GAITS = (Objective.MIN_POWER, Objective.CRUISE, Objective.MAX_SPEED)
REQUESTS = {
    "at_power_W": Objective.MAX_SPEED_AT_POWER,
    "at_speed_m_s": Objective.MIN_POWER_AT_SPEED,
}
_COSTS = {"at_power_W": at_power, "at_speed_m_s": at_speed}


@dataclass(frozen=True)
class Variable:
    """Result that each point has: its ``dimensions`` in addition to those of the points, ``unit`` and ``long_name``."""

    dimensions: tuple[str, ...]
    unit: str
    long_name: str


def gait_names(study: Study) -> list[str]:
    """Return the names of the gaits of a point.

    They are `THREE_GAITS`, and those of `REQUESTS` for whose key the study contains a value.
    """
    named = {*study.fixed, *study.varied}
    wanted = [objective for key, objective in REQUESTS.items() if key in named]
    return [objective.name.lower() for objective in (*THREE_GAITS, *wanted)]


_OF_GAIT = {
    "stroke": ("m", "stroke"),
    "frequency": ("Hz", "frequency"),
    "speed": ("m/s", "speed along the direction, with the margin"),
    "power": ("W", "mean source power, with the margin"),
    "cost_of_transport": ("1", "cost of transport, with the margin"),
    "grooves_per_cycle": ("1", "mean grooves gained in an averaged cycle, with the margin"),
}
_OF_SHAPE = {name: (GAIT_UNITS[name], GAIT_MEANINGS[name]) for name in SHAPE_ROW.names or ()}
_NOMINAL = {
    "nominal_speed": ("m/s", "speed along the direction, without a margin"),
    "nominal_power": ("W", "mean source power, without a margin"),
}


def _of_gait(study: Study) -> dict[str, tuple[str, str]]:
    """Return the unit and the description of each result of a gait, by name."""
    return {**_OF_GAIT, **(_OF_SHAPE if study.waveform is Waveform.SHAPED else {})}


def variables(study: Study) -> dict[str, Variable]:
    """Return the variables of a study, by name."""
    of_gait = _of_gait(study)
    variables_of = {
        "margin": Variable((), "m", "margin of front and gaits"),
        "groove_phase": Variable((), "m", "groove phase of the point"),
        "closed_form_cliff_margin": Variable((), "m", "margin of the cliff in the slow limit"),
    }
    if "front" in study.compute:
        variables_of["front_size"] = Variable((), "1", "gaits of the whole front")
        variables_of["hypervolume"] = Variable(
            (), "m W/s", "area that the whole front dominates, up to the reference power"
        )
        variables_of |= {
            f"front_{name}": Variable((FRONT,), unit, f"of the front: {words}")
            for name, (unit, words) in of_gait.items()
            if name != "cost_of_transport"
        }
    if "gaits" in study.compute or "success" in study.compute:
        rows = {**of_gait, **_NOMINAL}
        variables_of |= {name: Variable((GAIT,), *row) for name, row in rows.items()}
    if "cliff" in study.compute or study.margin_at_cliff:
        variables_of["cliff_margin"] = Variable((), "m", "margin at the cliff")
        variables_of["cliff_rise"] = Variable(
            (), "1", "factor of the lowest cost of transport at the cliff"
        )
        variables_of["scan_cost_of_transport"] = Variable(
            (SCAN,), "1", "lowest cost of transport of the scan"
        )
    if "success" in study.compute:
        for name, words in (
            ("", "at the known groove phase"),
            ("_any_phase", "at an unknown phase"),
        ):
            text = f"share of draws of parameters and travel error that gain the predicted grooves, {words}"
            variables_of[f"success_probability{name}"] = Variable((GAIT,), "1", text)
    if "any_phase" in study.compute:
        variables_of |= {
            f"any_phase_{name}": Variable((GAIT,), unit, f"of any-phase gaits: {words}")
            for name, (unit, words) in of_gait.items()
        }
    return variables_of


def dimensions(study: Study) -> dict[str, Sequence[Any]]:
    """Return the dimensions of the results of one point, with their coordinates."""
    return {
        FRONT: list(range(study.resolution.front_gaits)),
        GAIT: gait_names(study),
        SCAN: [float(margin) for margin in study.scan.margins()],
    }


Results = dict[str, np.ndarray]


def compute_block(study: Study, points: Array) -> Results:
    """Return the values of all variables for a block of points, and the ``state`` and ``reason`` of each point.

    Args:
        study: study.
        points: points of the block, shape (n, len(study.varied)).

    Returns:
        The variables by name, each of shape (n, …). The values of a failed point are NaN.
    """
    sizes = {name: len(values) for name, values in dimensions(study).items()}
    results: Results = {
        name: np.full((len(points), *(sizes[d] for d in variable.dimensions)), np.nan)
        for name, variable in variables(study).items()
    }
    results["state"] = np.full(len(points), DONE, dtype=np.int8)
    reasons = [""] * len(points)
    for row, point in enumerate(points):
        try:
            of_point = compute_point(study, dict(zip(study.varied, point.tolist(), strict=True)))
        except (InputError, SimulationError) as error:
            results["state"][row] = FAILED
            reasons[row] = " ".join(str(error).split())
            continue
        for name, value in of_point.items():
            # All NaN get the same bits, so that the results do not depend on the blocks.
            results[name][row] = np.where(np.isnan(value), np.nan, value)
    return {**results, "reason": np.array(reasons)}


def compute_point(study: Study, values: Mapping[str, float]) -> dict[str, Any]:
    """Return the results of one point, by name.

    Unavailable results, such as the gaits of an empty front, are omitted or NaN.

    Args:
        study: study.
        values: values of the varied quantities, by the names of `Study.varied`.

    Raises:
        InputError: The point is not admissible.
        SimulationError: The simulator failed at the point.
    """
    given = {**study.fixed, **values}
    content = content_of(study, given)
    task = task_of(study, given, content.parameters)
    results: dict[str, Any] = {
        "groove_phase": groove_phase(content.parameters),
        "closed_form_cliff_margin": cliff_margin(content.parameters),
    }
    settings = settings_of(study, given)
    margin: float | None = given.get("margin_m")
    if "cliff" in study.compute or study.margin_at_cliff:
        price = price_of(task, settings)
        results |= _cliff(price)
        if study.margin_at_cliff:
            margin = price.margin if price.moves else None
    if margin is not None:
        results["margin"] = margin
        if {"front", "gaits", "success"} & set(study.compute):
            exact = front_of_task(
                waveform_task(task.with_margin(margin), settings), study.resolution.scan
            )
            results |= _robust(study, given, content, task, exact)
    if "any_phase" in study.compute:
        front = front_of_task(any_phase_task(task), study.resolution.scan)
        chosen = _chosen(study, given, front, content.parameters)
        results |= {f"any_phase_{name}": column for name, column in chosen.items()}
    return results


def content_of(study: Study, given: Mapping[str, float]) -> ParameterFile:
    """Return the robot of a point: its parameter file with the given values, under the given conditions.

    If a value is given, its interval and its run-to-run deviation are scaled by the same factor. If the old value is 0,
    the interval is shifted instead, and the deviation stays the same. Conditions shift intervals, see `content_under`.

    Args:
        study: study.
        given: values of all varied and fixed quantities, by name.
    """
    content = study.files[int(given.get(PARAMETER_FILE, 0))][1]
    old = content.parameters
    changes = {key: given[key] for key in KEYS if key in given}
    new = old.replace(**changes)
    if "groove_phase_m" in given:
        phase = given["groove_phase_m"]
        if not -0.5 * new.pitch < phase <= 0.5 * new.pitch:
            raise InputError(
                f"groove_phase_m: {phase:g} m is not within half a pitch of {new.pitch:g} m"
            )
        new = new.replace(initial_length=front_groove(old) * new.pitch + phase)
    before, after = old.as_dict(), new.as_dict()

    def moved(key: str, ends: tuple[float, float]) -> tuple[float, float]:
        if not before[key]:
            return ends[0] + after[key], ends[1] + after[key]
        scaled = [after[key] / before[key] * end for end in ends]
        return min(scaled), max(scaled)

    changed = dataclasses.replace(
        content,
        parameters=new,
        intervals={key: moved(key, ends) for key, ends in content.intervals.items()},
        run_to_run={
            key: value * abs(after[key] / before[key] if before[key] else 1.0)
            for key, value in content.run_to_run.items()
        },
    )
    conditions = {key: given[key] for key in CONDITION_ROWS if key in given}
    return content_under(Conditions(**conditions), changed)


def settings_of(study: Study, given: Mapping[str, float]) -> Settings:
    """Return the settings of the search at a point: margin scan, waveform and bounds of the shapes (cf. `task_of`)."""
    plain = dataclasses.astuple(ShapeBounds())
    ends = (
        tuple(given.get(name, end) for name, end in zip(names, row, strict=True))
        for names, row in zip(SHAPE_BOUNDS, plain, strict=True)
    )
    return Settings(scan=study.scan, waveform=study.waveform, shapes=ShapeBounds(*ends))


def task_of(study: Study, given: Mapping[str, float], parameters: Parameters) -> MarginTask:
    """Return the optimisation task of a point, without a margin."""
    plain = Bounds()
    box = {
        "stroke_low": given.get("min_stroke_m", plain.stroke_low),
        "stroke_high": given.get("max_stroke_m", plain.stroke_high),
        "frequency_low": given.get("min_frequency_Hz", plain.frequency_low),
        "frequency_high": given.get("max_frequency_Hz", plain.frequency_high),
    }
    limits = ActuatorLimits(*(given.get(name, math.inf) for name in LIMITS))
    if study.hardware.driver is not None:
        driver = study.hardware.driver
        if "spool_radius_m" in given:
            radii = (given["spool_radius_m"],) * len(driver.spool_radii)
            driver = dataclasses.replace(driver, spool_radii=radii)
        box["stroke_high"] = min(box["stroke_high"], driver.max_stroke)
        box["frequency_high"] = min(box["frequency_high"], driver.max_frequency)
        model = servo_model(study.hardware.model)
        limits = limits.tightened(limits_of(driver, model, study.hardware.voltage))
    direction = int(given.get("direction", FORWARD))
    return MarginTask(
        parameters,
        direction,
        bounds=Bounds(**box),
        limits=limits,
        holding_power=given.get("holding_power_W_per_N", 0.0),
    )


def _cliff(price: PriceOfRobustness) -> dict[str, Any]:
    results: dict[str, Any] = {
        "scan_cost_of_transport": [point.cost_of_transport for point in price.points]
    }
    if price.cliff is not None:
        results |= {"cliff_margin": price.cliff.margin, "cliff_rise": price.cliff.rise}
    return results


def _robust(
    study: Study,
    given: Mapping[str, float],
    content: ParameterFile,
    task: MarginTask,
    exact: ExactFront,
) -> dict[str, Any]:
    """Return the results of an exact front: stored front, chosen gaits and success probabilities.

    ``task`` is the task of ``exact`` without the margin. The nominal predictions result from it.
    """
    front = exact.front
    results: dict[str, Any] = {}
    if "front" in study.compute:
        results["front_size"] = len(front)
        corner = given.get("reference_power_W", REFERENCE_POWER)
        results["hypervolume"] = hypervolume(front, corner)
        if len(front):
            results |= _kept_front(study, front, content.parameters)
    if not len(front) or not {"gaits", "success"} & set(study.compute):
        return results
    chosen = _chosen(study, given, exact, content.parameters)
    results |= chosen
    known = np.isfinite(chosen["stroke"])
    gaits = chosen["stroke"][known], chosen["frequency"][known]
    shape = _shapes(chosen, known)
    nominal = task.table(*gaits, shape=shape)
    results["nominal_speed"] = _spread(nominal.speed, known)
    results["nominal_power"] = _spread(nominal.power + task.held_power(*gaits, shape), known)
    if "success" in study.compute:
        required = chosen["grooves_per_cycle"][known]
        samples, seed = study.resolution.samples, study.resolution.seed
        for name, draw in (("", phase_known), ("_any_phase", phase_unknown)):
            draws = draw(content, samples, seed)
            share = success_probability(task, *gaits, required, draws, shape)
            results[f"success_probability{name}"] = _spread(share, known)
    return results


def _shapes(chosen: Mapping[str, Array], known: np.ndarray) -> Shapes:
    """Return the shapes of the chosen gaits for which ``known`` is True; in a study of sinusoids, the paper's shape."""
    fields = {name: chosen[name][known] for name in SHAPE_ROW.names or () if name in chosen}
    return shapes_of(int(np.count_nonzero(known)), **fields)


def _spread(values: Array, known: np.ndarray) -> Array:
    """Return an array with the values where ``known`` is True, and NaN elsewhere."""
    spread = np.full(known.shape, np.nan)
    spread[known] = values
    return spread


def _kept_front(study: Study, front: Points, parameters: Parameters) -> dict[str, Array]:
    """Return the quantities of the stored gaits of a front, padded with NaN to ``front_gaits`` rows."""
    count = study.resolution.front_gaits
    kept = front.take(thinned(front, parameters, count))
    columns = _figures(study, kept, parameters)
    del columns["cost_of_transport"]
    return {
        f"front_{name}": np.pad(
            column.astype(float), (0, count - len(kept)), constant_values=np.nan
        )
        for name, column in columns.items()
    }


def _chosen(
    study: Study, given: Mapping[str, float], exact: ExactFront, parameters: Parameters
) -> dict[str, Array]:
    """Return the quantities of the gaits of `gait_names`, one column per quantity; NaN if no gait meets a request."""
    names = gait_names(study)
    columns = {name: np.full(len(names), np.nan) for name in _of_gait(study)}
    if not len(exact.front):
        return columns
    costs: list[Cost] = [power_cost, transport_cost, speed_cost]
    costs += [_COSTS[key](given[key]) for key in REQUESTS if key in given]
    for place, cost in enumerate(costs):
        gait = exact.cheapest(cost)
        for name, value in _figures(study, gait, parameters).items():
            columns[name][place : place + 1] = value if len(gait) else np.nan
    return columns


def _figures(study: Study, points: Points, parameters: Parameters) -> dict[str, Array]:
    """Return the quantities of gaits, by the names of `_of_gait`."""
    shaped = study.waveform is Waveform.SHAPED
    return {
        **({name: points.shape[name] for name in _OF_SHAPE} if shaped else {}),
        **{name: getattr(points, name) for name in ("stroke", "frequency", "speed", "power")},
        "cost_of_transport": cost_of_transport(points.speed, points.power, parameters.mass),
        "grooves_per_cycle": points.grooves,
    }
