# SPDX-License-Identifier: Apache-2.0
"""Evaluation of many gaits with many parameter sets, on all cores."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from worm_model.arrays import Array
from worm_model.gait import AVERAGED, CYCLES, check_body
from worm_model.parameters import KEYS, PAPER, ParameterError, Parameters
from worm_model.simulation.kernel import whole_run as run
from worm_model.simulation.kernel.mode import nearest_groove
from worm_model.simulation.kernel.work import cable_power
from worm_model.simulation.rows import GAIT_ROW, Rows, parameter_rows
from worm_model.simulation.simulator import check_cycles, cost_of_transport
from worm_msgs.gait import GAIT_DEFAULTS, Gait, GaitError, Profile

# Largest amount, in pitches, by which the transient may reduce the advance of a cycle below a whole number of grooves
_TRANSIENT = 0.05
CHUNK = 256  # gaits in one task of a thread; the task takes some milliseconds


@dataclass(frozen=True)
class GaitTable:
    """Results of many gaits. Each field is an array of the broadcast shape; for the meaning see `simulator.GaitResult`.

    ``gait`` contains such an array for each field of `Gait`. Speed, power and grooves of a gait are NaN, and its cost
    of transport is infinite, if a fin chatters (`simulator.SimulationError`) or if the fins do not hold the load at
    rest.
    """

    gait: Mapping[str, Array]
    speed: Array
    power: Array
    cost_of_transport: Array
    grooves_per_cycle: Array
    min_grooves: Array
    groove_phase: Array
    switches: NDArray[np.int64]


def branch_of(table: GaitTable) -> NDArray[np.int64]:
    """Return the whole number of grooves that each gait of a table gains in its worst averaged cycle, at least 0.

    The advance of the rear module in the table, in pitches, differs from a whole number by the rest of the transient.
    Gaits that the simulator cannot evaluate (NaN) gain nothing.
    """
    advance = np.nan_to_num(table.min_grooves, nan=0.0)
    return np.floor(np.maximum(advance, 0.0) + _TRANSIENT).astype(np.int64)


def _gait_rows(fields: Mapping[str, ArrayLike], *others: ArrayLike) -> tuple[Rows, tuple[int, ...]]:
    """Return the gaits as rows (n,) of GAIT_ROW, and the shape to which their fields and ``others`` are broadcast.

    A missing field has the default of `Gait`. Raises the errors of `evaluate_gaits`.
    """
    names = GAIT_ROW.names or ()
    unknown = sorted(set(fields) - set(names))
    if unknown:
        raise GaitError(f"{unknown[0]}: no field of a gait; there are {', '.join(names)}")
    columns = {name: np.asarray(each, float) for name, each in {**GAIT_DEFAULTS, **fields}.items()}
    shape = np.broadcast_shapes(*map(np.shape, [*columns.values(), *others]))
    rows = np.empty(math.prod(shape), GAIT_ROW)
    for name in names:
        rows.reshape(shape)[name] = columns[name]
    if not len(rows):
        return rows, shape
    values = rows.view(float).reshape(len(rows), len(names))
    extremes = values.min(axis=0), values.max(axis=0)  # NaN if a column contains NaN
    if not np.all(np.isfinite(extremes)):
        raise ValueError(f"gaits: every {', '.join(names)} must be finite")
    if np.any(np.abs(rows["direction"]) != 1.0):
        raise GaitError("direction: every direction must be 1 (forward) or -1 (reverse)")
    if not np.all(np.any([rows["profile"] == profile for profile in Profile], axis=0)):
        raise GaitError(f"profile: every profile must be one of {', '.join(map(str, Profile))}")
    # The limits of a column do not depend on other columns, so it is sufficient to check the extremes of each column.
    for extreme in extremes:
        Gait(**dict(zip(names, extreme.tolist(), strict=True)))
    return rows, shape


def _parameter_rows(
    parameters: Parameters, overrides: Mapping[str, ArrayLike], shape: tuple[int, ...]
) -> Rows:
    row = parameter_rows(parameters)
    if not overrides:
        return row
    unknown = sorted(set(overrides) - set(KEYS))
    if unknown:
        raise ParameterError(f"{unknown[0]}: no such parameter")
    rows = np.tile(row, int(np.prod(shape)))
    for key, values in overrides.items():
        rows[key] = np.broadcast_to(np.asarray(values, float), shape).ravel()
    _check_rows(rows)
    return rows


def check_bodies(reach: ArrayLike, initial_length: ArrayLike) -> None:
    """Raise `GaitError` unless each ``reach`` (m) is below the body length at rest (m). Arguments broadcast.

    The reach of a gait is its pretension plus its stroke.
    """
    reaches, lengths = np.broadcast_arrays(*np.atleast_1d(reach, initial_length))
    if reaches.size:
        worst = np.unravel_index(np.argmax(reaches - lengths), reaches.shape)
        check_body(float(reaches[worst]), float(lengths[worst]))


def _check_rows(rows: Rows) -> None:
    """Raise the `ParameterError` of `Parameters` if a row is not admissible.

    `Parameters` limits each value, and the differences 2·p_sw − d and 2·p_sw − δ_c. Therefore only the rows with the
    extremes of these quantities are checked. If these rows are admissible, all rows are.
    """
    if not len(rows):
        return
    suspects = [pick(rows[key]) for key in KEYS for pick in (np.argmin, np.argmax)]
    suspects += [
        np.argmin(2.0 * rows["switching_threshold"] - rows[key]) for key in ("pitch", "clearance")
    ]
    for index in np.unique(suspects):
        PAPER.replace(**{key: float(rows[key][index]) for key in KEYS})


def evaluate_gaits(
    stroke: ArrayLike,
    frequency: ArrayLike,
    margin: ArrayLike = 0.0,
    direction: ArrayLike = 1,
    parameters: Parameters = PAPER,
    overrides: Mapping[str, ArrayLike] | None = None,
    cycles: int = CYCLES,
    averaged: int = AVERAGED,
    progress: Callable[[float], None] | None = None,
    **further: ArrayLike,
) -> GaitTable:
    """Return for every gait the results that `simulator.evaluate_gait` returns for a single gait.

    The fields of the gaits and the values of ``overrides`` are broadcast against each other. Stroke plus pretension
    must be below the body length. This is not checked if ``overrides`` contains ``initial_length``, because a scenario
    may draw any length.

    Args:
        stroke: m.
        frequency: Hz.
        margin: m.
        direction: ±1.
        parameters: parameters of the robot.
        overrides: values that replace parameters, in SI units, by parameter key.
        cycles: cycles of each run, from the start.
        averaged: number of cycles at the end of the run over which the results are averaged.
        progress: called in the calling thread with the fraction done, 0 to 1. An exception that it raises is passed on,
            and the remaining gaits are not evaluated.
        further: further fields of `Gait`; without a value, the default of `Gait` is used.

    Raises:
        GaitError: A field of a gait is unknown or out of its limits, or stroke plus pretension is not below the body
            length.
        ParameterError: An override is unknown, not finite or out of its limits.
        ValueError: A field of a gait is not finite, or the number of cycles is impossible.
    """
    check_cycles(cycles, averaged)
    overrides = overrides or {}
    gaits = {"stroke": stroke, "frequency": frequency, "direction": direction, "margin": margin}
    rows, shape = _gait_rows({**gaits, **further}, *overrides.values())
    parameters_of_rows = _parameter_rows(parameters, overrides, shape)
    if "initial_length" not in overrides:
        check_bodies(rows["stroke"] + rows["pretension"], parameters.initial_length)
    results = np.empty((len(rows), run.RESULT_COLUMNS))

    def work(part: slice) -> None:
        own = parameters_of_rows if len(parameters_of_rows) == 1 else parameters_of_rows[part]
        run.evaluate_many(rows[part], own, cycles, averaged, results[part])

    _on_all_cores(work, len(rows), progress)
    return _table(rows, parameters_of_rows, results, shape)


def _on_all_cores(
    work: Callable[[slice], None],
    count: int,
    progress: Callable[[float], None] | None = None,
) -> None:
    """Process ``count`` rows in chunks, in a pool of threads.

    The threads run in parallel, because the kernel releases Python's global interpreter lock.
    """
    parts = [slice(start, min(start + CHUNK, count)) for start in range(0, count, CHUNK)]
    # A single chunk is processed in this thread: searches evaluate a few rows at a time, which takes less time than
    # starting a thread.
    if len(parts) == 1:
        work(parts[0])
        if progress is not None:
            progress(1.0)
        return
    done = 0
    with ThreadPoolExecutor(max_workers=os.cpu_count()) as pool:
        futures = {pool.submit(work, part): part for part in parts}
        try:
            for future in as_completed(futures):
                future.result()
                done += futures[future].stop - futures[future].start
                if progress is not None:
                    progress(done / count)
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise


def sample_cycle(
    stroke: ArrayLike,
    frequency: ArrayLike,
    direction: int,
    parameters: Parameters,
    cycle: int,
    phases: ArrayLike,
    **further: ArrayLike,
) -> tuple[Array, Array]:
    """Return (cable force F_c in N, source power in W) of gaits at times within one cycle of their runs.

    Force and power have the shape (n, m) and equal those of `simulator.simulate`. They are NaN for a gait with a fin
    that chatters, or with fins that do not hold the load at rest.

    Args:
        stroke: strokes (n,), m.
        frequency: frequencies (n,), Hz.
        direction: ±1.
        parameters: parameters of the robot.
        cycle: number of the cycle in the run, from 0.
        phases: times as fractions of the cycle, 0 to 1, ascending, (m,) or (n, m).
        further: as in `evaluate_gaits`.
    """
    gaits = {"stroke": stroke, "frequency": frequency, "direction": direction}
    rows, _ = _gait_rows({**gaits, **further}, np.empty(1))
    row, given = parameter_rows(parameters)[0], np.asarray(phases, dtype=float)
    shares = np.broadcast_to(given, (len(rows), given.shape[-1])).copy()
    force, length_rate = np.empty((2, *shares.shape))

    def work(part: slice) -> None:
        run.sample_many(rows[part], row, cycle, shares[part], force[part], length_rate[part])

    _on_all_cores(work, len(rows))
    mechanical = cable_power(force, length_rate, parameters.one_sided_cable)
    return force, parameters.idle_power + parameters.power_factor * mechanical


def _table(
    rows: Rows, parameters_of_rows: Rows, results: Array, shape: tuple[int, ...]
) -> GaitTable:
    def parameter(key: str) -> Array:
        return np.broadcast_to(parameters_of_rows[key], (len(rows),)).reshape(shape)

    gait = {name: rows[name].reshape(shape) for name in GAIT_ROW.names or ()}
    advance = results[:, run.MEAN_ADVANCE].reshape(shape)
    power = results[:, run.MEAN_POWER].reshape(shape)
    pitch, initial_length = parameter("pitch"), parameter("initial_length")
    speed = advance * gait["frequency"]
    mass = parameter("rear_mass") + parameter("front_mass")
    return GaitTable(
        gait=gait,
        speed=speed,
        power=power,
        cost_of_transport=cost_of_transport(speed, power, mass),
        grooves_per_cycle=advance / pitch,
        min_grooves=results[:, run.LEAST_ADVANCE].reshape(shape) / pitch,
        groove_phase=initial_length - nearest_groove(initial_length, pitch) * pitch,
        switches=results[:, run.RUN_SWITCHES].reshape(shape).astype(np.int64),
    )
