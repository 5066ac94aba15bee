# SPDX-License-Identifier: Apache-2.0
"""Computation of the results of one point of a study."""

from __future__ import annotations

import dataclasses
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
from worm_msgs.gait import FORWARD
from worm_optimizer.evaluation.actuator_limits import ActuatorLimits
from worm_optimizer.evaluation.task import Bounds, MarginTask, Points
from worm_optimizer.robustness.prediction import success_probability
from worm_optimizer.robustness.uncertainty import phase_known, phase_unknown
from worm_optimizer.search.exact import ExactFront, power_cost, speed_cost, transport_cost
from worm_optimizer.search.front import any_phase_task, front_of_task, thinned
from worm_optimizer.search.gait_request import Objective, at_power, at_speed
from worm_optimizer.search.price_of_robustness import price_of_robustness
from worm_optimizer.study.study_file import BOUNDS, LIMITS, PARAMETER_FILE, Array, Quantity, Study

FRONT, GAIT, SCAN = "front_gait", "gait", "scan_margin"  # dimensions of the results of one point
DONE, FAILED = 1, 2  # values of the variable "state"
# Gaits of each point with their costs, and those of the points with a value of a quantity
_THREE = {
    Objective.MIN_POWER: power_cost,
    Objective.CRUISE: transport_cost,
    Objective.MAX_SPEED: speed_cost,
}
_REQUESTED = {
    "at_power_W": (Objective.MAX_SPEED_AT_POWER, at_power),
    "at_speed_m_s": (Objective.MIN_POWER_AT_SPEED, at_speed),
}


@dataclass(frozen=True)
class Variable:
    """Result that each point has: its ``dimensions`` in addition to those of the points, ``unit`` and ``long_name``."""

    dimensions: tuple[str, ...]
    unit: str
    long_name: str


_OF_GAIT = {
    "stroke": ("m", "stroke"),
    "frequency": ("Hz", "frequency"),
    "speed": ("m/s", "speed along the direction, with the margin"),
    "power": ("W", "mean source power, with the margin"),
    "cost_of_transport": ("1", "cost of transport, with the margin"),
    "grooves_per_cycle": ("1", "mean grooves gained in an averaged cycle, with the margin"),
}
_NOMINAL = {
    "nominal_speed": ("m/s", "speed along the direction, without a margin"),
    "nominal_power": ("W", "mean source power, without a margin"),
}
_DRAWN = "share of draws of parameters and travel error that gain the predicted grooves, at"
_SUCCESS = {
    "success_probability": ("1", f"{_DRAWN} the known groove phase"),
    "success_probability_any_phase": ("1", f"{_DRAWN} an unknown phase"),
}


def variables(study: Study) -> dict[str, Variable]:
    """Return the variables of a study, by name."""
    compute = study.file.compute
    found = {
        "margin": Variable((), "m", "margin of front and gaits"),
        "groove_phase": Variable((), "m", "groove phase of the point"),
        "closed_form_cliff_margin": Variable((), "m", "margin of the cliff in the slow limit"),
    }
    if "front" in compute:
        found["front_size"] = Variable((), "1", "gaits of the whole front")
        found |= {
            f"front_{name}": Variable((FRONT,), unit, f"of the front: {words}")
            for name, (unit, words) in _OF_GAIT.items()
            if name != "cost_of_transport"
        }
    of_gait = _OF_GAIT | _NOMINAL if {"gaits", "success"} & set(compute) else {}
    of_gait = of_gait | (_SUCCESS if "success" in compute else {})
    found |= {name: Variable((GAIT,), *row) for name, row in of_gait.items()}
    if "cliff" in compute or study.file.margin_at_cliff:
        found["cliff_margin"] = Variable((), "m", "margin at the cliff")
        found["cliff_rise"] = Variable(
            (), "1", "factor of the lowest cost of transport at the cliff"
        )
        found["scan_cost_of_transport"] = Variable(
            (SCAN,), "1", "lowest cost of transport of the scan"
        )
    if "any_phase" in compute:
        found |= {
            f"any_phase_{name}": Variable((GAIT,), unit, f"of any-phase gaits: {words}")
            for name, (unit, words) in _OF_GAIT.items()
        }
    return found


def dimensions(study: Study) -> dict[str, Sequence[Any]]:
    """Return the dimensions of the results of one point, with their coordinates.

    The gaits are the paper's three, and those for whose quantity the study contains a value.
    """
    named = {*study.file.fixed, *study.file.vary}
    requested = (objective for key, (objective, _) in _REQUESTED.items() if key in named)
    return {
        FRONT: range(study.file.resolution.front_gaits),
        GAIT: [objective.name.lower() for objective in (*_THREE, *requested)],
        SCAN: study.file.scan.margins().tolist(),
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
    """
    file, given = study.file, {**study.file.fixed, **values}
    content = content_of(study, given)
    parameters = content.parameters
    task = task_of(given, parameters)
    results: dict[str, Any] = {
        "groove_phase": groove_phase(parameters),
        "closed_form_cliff_margin": cliff_margin(parameters),
    }
    margin: float | None = given.get("margin_m")
    if "cliff" in file.compute or file.margin_at_cliff:
        price = price_of_robustness(task, file.scan.margins())
        results["scan_cost_of_transport"] = [each.cost_of_transport for each in price.points]
        if price.cliff is not None:
            results |= {"cliff_margin": price.cliff.margin, "cliff_rise": price.cliff.rise}
        if file.margin_at_cliff:
            margin = price.margin if price.moves else None
    if margin is not None:
        results["margin"] = margin
        if {"front", "gaits", "success"} & set(file.compute):
            exact = front_of_task(task.with_margin(margin), file.resolution.scan)
            results |= _robust(study, given, content, task, exact)
    if "any_phase" in file.compute:
        front = front_of_task(any_phase_task(task), file.resolution.scan)
        chosen = _chosen(study, given, front, parameters)
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
    content = study.robots[int(given.get(PARAMETER_FILE, 0))][1]
    old = content.parameters
    new = old.replace(**{key: given[key] for key in KEYS if key in given})
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


def task_of(given: Mapping[str, float], parameters: Parameters) -> MarginTask:
    """Return the optimisation task of a point, without a margin."""
    return MarginTask(
        parameters,
        int(given.get("direction", FORWARD)),
        bounds=Bounds(**_fields(BOUNDS, given)),
        limits=ActuatorLimits(**_fields(LIMITS, given)),
    )


def _fields(rows: Mapping[str, Quantity], given: Mapping[str, float]) -> dict[str, float]:
    return {row.field: given[name] for name, row in rows.items() if name in given}


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
    compute, resolution = study.file.compute, study.file.resolution
    front, parameters = exact.front, content.parameters
    results: dict[str, Any] = {}
    if "front" in compute:
        results["front_size"] = len(front)
        if len(front):
            kept = front.take(thinned(front, parameters, resolution.front_gaits))
            for name, column in _figures(kept, parameters).items():
                stored = np.full(resolution.front_gaits, np.nan)
                stored[: len(kept)] = column
                results[f"front_{name}"] = stored
            del results["front_cost_of_transport"]
    if not len(front) or not {"gaits", "success"} & set(compute):
        return results
    chosen = _chosen(study, given, exact, parameters)
    known = np.isfinite(chosen["stroke"])
    gaits = chosen["stroke"][known], chosen["frequency"][known]
    nominal = task.table(*gaits)
    further = {"nominal_speed": nominal.speed, "nominal_power": nominal.power}
    if "success" in compute:
        required = chosen["grooves_per_cycle"][known]
        for name, draw in zip(_SUCCESS, (phase_known, phase_unknown), strict=True):
            draws = draw(content, resolution.samples, resolution.seed)
            further[name] = success_probability(task, *gaits, required, draws)
    for name, column in further.items():
        chosen[name] = np.full(known.shape, np.nan)
        chosen[name][known] = column
    return results | chosen


def _chosen(
    study: Study, given: Mapping[str, float], exact: ExactFront, parameters: Parameters
) -> dict[str, Array]:
    """Return the quantities of the gaits of a point, one column per quantity; NaN if no gait meets a request."""
    columns = {name: np.full(len(dimensions(study)[GAIT]), np.nan) for name in _OF_GAIT}
    if not len(exact.front):
        return columns
    requested = [cost(given[key]) for key, (_, cost) in _REQUESTED.items() if key in given]
    for place, cost in enumerate((*_THREE.values(), *requested)):
        gait = exact.cheapest(cost)
        for name, column in _figures(gait, parameters).items():
            if len(gait):
                columns[name][place] = column[0]
    return columns


def _figures(points: Points, parameters: Parameters) -> dict[str, Array]:
    """Return the quantities of gaits, by the names of `_OF_GAIT`."""
    return {
        **{name: getattr(points, name) for name in ("stroke", "frequency", "speed", "power")},
        "cost_of_transport": cost_of_transport(points.speed, points.power, parameters.mass),
        "grooves_per_cycle": points.grooves,
    }
