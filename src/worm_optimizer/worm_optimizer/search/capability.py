# SPDX-License-Identifier: Apache-2.0
"""Capability of a robot: largest load and slope of gaits, and lowest cost of transport and highest speed by load."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from worm_model.gait import Gait
from worm_model.simulation.closed_form import largest_load
from worm_model.simulation.simulator import cost_of_transport
from worm_msgs.robot_parameters import STANDARD_GRAVITY
from worm_optimizer.evaluation.command_shape import SINUSOID, Shapes, shapes_of_gaits
from worm_optimizer.evaluation.task import Array, MarginTask, Mask
from worm_optimizer.search.exact import Resolution, Zoom, exact_front

# Returns arrays of parameter values by key. The argument is an array of loads or slopes, and each array of values has
# the shape of the argument.
Overrides = Callable[[Array], Mapping[str, Array]]

_SCAN = 65  # number of loads or slopes in the first scan of a gait
_TOLERANCE = 1e-4  # tolerance of the bisection, relative to the range of the scan
# Size of the first grid over the box in the search for the strongest gait
_STROKES, _FREQUENCIES = 41, 17
_ZOOMS = 4  # number of finer grids around the strongest gait found so far
_CURVE = 13  # number of loads in `curve`
_RESOLUTION, _ZOOM = Resolution(strokes=21, frequencies=17), Zoom(points=9, rounds=5)  # for `curve`
_STEEPEST = 90.0  # largest slope that is searched, degrees


@dataclass(frozen=True)
class Capability:
    """Largest loads and slopes of a gait. All loads are added to those of the robot's parameters.

    Attributes:
        gait: gait, with margin 0.
        largest_load: largest load on the rear module with which the gait gains a groove in every averaged cycle, N; 0
            for a gait that does not move.
        largest_slope_deg: largest slope on which the gait gains a groove in every averaged cycle, degrees; 0 for a gait
            that does not move.
        full_load: largest load on the rear module with which every averaged cycle gains at least as many grooves as the
            worst averaged cycle without this load, N; 0 for a gait that does not move.
        closed_form_largest_load: ``largest_load`` by a closed form for slow gaits, which neglects viscous friction, N;
            NaN for a gait that, by this closed form, does not move without loads, and negative for one that does not
            move under the loads of the robot's parameters.
    """

    gait: Gait
    largest_load: float
    largest_slope_deg: float
    full_load: float
    closed_form_largest_load: float


@dataclass(frozen=True)
class LoadPoint:
    """Lowest ``cost_of_transport`` and highest ``speed`` (m/s) of all gaits at a ``load`` (N); NaN if no gait moves."""

    load: float
    cost_of_transport: float
    speed: float


def loads_on_rear(task: MarginTask) -> Overrides:
    """Return the `Overrides` of loads in N on the rear module, against the direction of the task."""
    base, direction = task.parameters.rear_load, task.direction
    return lambda loads: {"rear_load": base + direction * loads}


def slopes(task: MarginTask) -> Overrides:
    """Return the `Overrides` of slopes in degrees, uphill in the direction of the task."""
    p, direction = task.parameters, task.direction

    def under(degrees: Array) -> Mapping[str, Array]:
        rise = direction * STANDARD_GRAVITY * np.sin(np.radians(degrees))
        return {
            "rear_load": p.rear_load + p.rear_mass * rise,
            "front_load": p.front_load + p.front_mass * rise,
        }

    return under


def most_load(task: MarginTask) -> float:
    """Return a load in N with which no gait moves: it deflects both engaged fins to their thresholds even at rest."""
    p = task.parameters
    carried = 2.0 * p.engaged_stiffness * p.switching_threshold
    return (
        carried + abs(p.rear_load) + abs(p.front_load) + p.rear_dry_friction + p.front_dry_friction
    )


def largest(
    task: MarginTask,
    gaits: tuple[Array, Array, Shapes],
    overrides: Overrides,
    most: float,
    least_grooves: Array,
) -> Array:
    """Return the largest load or slope (n,) up to which each gait gains ``least_grooves`` in every averaged cycle.

    The result is 0 for a gait that does not gain them without load or slope, and ``most`` for a gait that gains them up
    to the end of the searched range.

    Args:
        task: robot and margin.
        gaits: stroke in m, frequency in Hz, and shape, (n,) each.
        overrides: returns the parameters under loads or slopes.
        most: end of the searched range, which begins at 0, in N or degrees.
        least_grooves: required grooves of each gait in every averaged cycle, (n,).
    """
    stroke, frequency = (column[:, np.newaxis] for column in gaits[:2])
    shape = gaits[2][:, np.newaxis]

    def keeps(values: Array) -> Mask:
        gained = task.grooves(stroke, frequency, overrides=overrides(values), shape=shape)
        return gained >= least_grooves[:, np.newaxis]

    values = np.linspace(0.0, most, _SCAN)
    kept = keeps(np.tile(values, (len(stroke), 1)))
    first = np.argmin(np.column_stack([kept, np.zeros(len(kept), dtype=bool)]), axis=1)
    good = values[np.maximum(first - 1, 0)]
    bad = np.where((first == 0) | (first == _SCAN), good, values[np.minimum(first, _SCAN - 1)])
    while (bad - good).max(initial=0.0) > _TOLERANCE * most:
        middle = 0.5 * (good + bad)
        stays = keeps(middle[:, np.newaxis])[:, 0]
        good, bad = np.where(stays, middle, good), np.where(stays, bad, middle)
    return good


def capabilities(task: MarginTask, gaits: Sequence[Gait]) -> tuple[Capability, ...]:
    """Return the capability of each gait, computed without a margin."""
    robot = task.with_margin(0.0)
    shape = shapes_of_gaits(gaits)
    columns = (
        np.array([gait.stroke for gait in gaits]),
        np.array([gait.frequency for gait in gaits]),
    )
    rows = (*columns, shape)
    one, own = np.ones(len(gaits)), robot.grooves(*columns, shape=shape)
    loads, most = loads_on_rear(robot), most_load(robot)
    found = zip(
        largest(robot, rows, loads, most, one).tolist(),
        largest(robot, rows, slopes(robot), _STEEPEST, one).tolist(),
        largest(robot, rows, loads, most, np.maximum(own, 1)).tolist(),
        strict=True,
    )
    present = task.direction * (task.parameters.rear_load + task.parameters.front_load)
    bare = [dataclasses.replace(gait, margin=0.0) for gait in gaits]
    return tuple(
        Capability(gait, *values, largest_load(gait, task.parameters) - present)
        for gait, values in zip(bare, found, strict=True)
    )


def strongest(task: MarginTask) -> Gait | None:
    """Return the sinusoid within the box that moves with the largest load; None if no gait moves without a load.

    The margin of the task is ignored.
    """
    robot, box = task.with_margin(0.0), task.bounds
    low = np.array([box.stroke_low, box.frequency_low])
    high = np.array([box.stroke_high, box.frequency_high])
    ends = np.stack([low, high])
    sizes = np.array([_STROKES, _FREQUENCIES])
    best = None
    for _ in range(1 + _ZOOMS):
        axes = [np.unique(np.linspace(ends[0, k], ends[1, k], int(sizes[k]))) for k in (0, 1)]
        stroke, frequency = (axis.ravel() for axis in np.meshgrid(*axes))
        shape = np.full(stroke.size, SINUSOID)
        rows = stroke, frequency, shape
        moves = robot.grooves(stroke, frequency) >= 1
        if not moves.any():
            break
        rows = stroke[moves], frequency[moves], shape[moves]
        loads = largest(robot, rows, loads_on_rear(robot), most_load(robot), np.ones(moves.sum()))
        row = int(np.argmax(loads))
        if best is None or loads[row] > best[0]:
            best = loads[row], rows[0][row], rows[1][row]
        step = (ends[1] - ends[0]) / (sizes - 1)
        centre, sizes = np.array(best[1:]), np.array([9, 9])
        ends = np.clip(np.stack([centre - step, centre + step]), low, high)
    if best is None:
        return None
    return Gait(float(best[1]), float(best[2]), task.direction)


def curve(task: MarginTask, most: float) -> tuple[LoadPoint, ...]:
    """Return the lowest cost of transport and the highest speed at evenly spaced loads on the rear module.

    The loads range from 0 to ``most`` (N). The gaits have the margin of the task.
    """
    points = []
    for load in np.linspace(0.0, most, _CURVE).tolist():
        changed = {
            key: float(value) for key, value in loads_on_rear(task)(np.asarray(load)).items()
        }
        loaded = dataclasses.replace(task, parameters=task.parameters.replace(**changed))
        front = exact_front(loaded, _RESOLUTION, _ZOOM).front
        if len(front):
            cost = cost_of_transport(front.speed, front.power, loaded.parameters.mass)
            points.append(LoadPoint(load, float(cost.min()), float(front.speed.max())))
        else:
            points.append(LoadPoint(load, np.nan, np.nan))
    return tuple(points)
