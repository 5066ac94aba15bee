# SPDX-License-Identifier: Apache-2.0
"""Many gaits and many parameter sets at once, on all cores."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from worm_model.gait import Gait, GaitError
from worm_model.parameters import KEYS, PAPER, ParameterError, Parameters
from worm_model.simulation.kernel import whole_run as run
from worm_model.simulation.kernel.mode import nearest_groove
from worm_model.simulation.kernel.work import cable_power
from worm_model.simulation.simulator import (
    AVERAGED,
    CYCLES,
    check_cycles,
    cost_of_transport,
    parameter_row,
)

Array = NDArray[np.float64]

CHUNK = 256  # gaits that one thread takes at a time: some milliseconds


@dataclass(frozen=True)
class GaitTable:
    """Figures of many gaits, each field an array of the broadcast shape; see `simulator.GaitResult`.

    Where the simulator gave up on a gait (chatter), its figures are NaN.
    """

    stroke: Array
    frequency: Array
    direction: Array
    margin: Array
    speed: Array
    power: Array
    cost_of_transport: Array
    grooves_per_cycle: Array
    min_grooves: Array
    groove_phase: Array
    switches: NDArray[np.int64]


def _gait_rows(columns: list[Array]) -> Array:
    rows = np.stack([column.ravel() for column in columns], axis=1)
    lowest = rows.min(axis=0, initial=np.inf)
    highest = rows.max(axis=0, initial=-np.inf)
    if rows.shape[0] and not np.all(np.isfinite(rows)):
        raise ValueError("gaits: every stroke, frequency, direction and margin must be finite")
    if np.any(np.abs(rows[:, 2]) != 1.0):
        raise GaitError("direction: every direction must be 1 (forward) or -1 (reverse)")
    if rows.shape[0]:  # the limits of a gait bound each column on its own: its extremes decide
        for stroke, frequency, direction, margin in (lowest, highest):
            Gait(stroke, frequency, int(direction), margin)
    return rows


def _parameter_rows(
    parameters: Parameters, overrides: Mapping[str, ArrayLike], shape: tuple[int, ...]
) -> Array:
    row = parameter_row(parameters)
    if not overrides:
        return row[np.newaxis]
    unknown = sorted(set(overrides) - set(KEYS))
    if unknown:
        raise ParameterError(f"{unknown[0]}: no such parameter")
    rows = np.tile(row, (int(np.prod(shape)), 1))
    for key, values in overrides.items():
        rows[:, KEYS.index(key)] = np.broadcast_to(np.asarray(values, float), shape).ravel()
    _check_rows(rows)
    return rows


def _check_rows(rows: Array) -> None:
    """Raises `ParameterError` as `Parameters` does if a row is not admissible; extremes speak for all."""
    threshold, clearance, pitch = (
        rows[:, KEYS.index(key)] for key in ("switching_threshold", "clearance", "pitch")
    )
    suspects = [rows.argmin(axis=0), rows.argmax(axis=0)]
    suspects += [np.argmin(2.0 * threshold - pitch), np.argmin(2.0 * threshold - clearance)]
    for index in np.unique(np.hstack(suspects)):
        Parameters(*rows[index, : len(KEYS)])


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
) -> GaitTable:
    """Figures of every gait, as `simulator.evaluate_gait` gives them one by one.

    ``stroke`` m, ``frequency`` Hz, ``margin`` m, ``direction`` ±1 and the values of ``overrides`` (parameter key
    to array, SI) are broadcast against each other. ``progress`` is called with the fraction done, in the
    calling thread; an exception it raises cancels the rest. Raises `GaitError`, `ParameterError` or
    ValueError for values that are not admissible.
    """
    check_cycles(cycles, averaged)
    overrides = overrides or {}
    gaits = [np.asarray(column, dtype=float) for column in (stroke, frequency, direction, margin)]
    shape = np.broadcast_shapes(*(g.shape for g in gaits), *map(np.shape, overrides.values()))
    columns = [np.broadcast_to(column, shape) for column in gaits]
    rows = _gait_rows(columns)
    parameter_rows = _parameter_rows(parameters, overrides, shape)
    results = np.empty((rows.shape[0], run.RESULT_COLUMNS))
    _evaluate_rows(rows, parameter_rows, cycles, averaged, results, progress)
    return _table(columns, parameter_rows, results, shape)


def _evaluate_rows(
    rows: Array,
    parameter_rows: Array,
    cycles: int,
    averaged: int,
    results: Array,
    progress: Callable[[float], None] | None,
) -> None:
    """Fills the results."""
    shared = parameter_rows.shape[0] == 1

    def work(part: slice) -> None:
        own = parameter_rows if shared else parameter_rows[part]
        run.evaluate_many(rows[part], own, cycles, averaged, results[part])

    _on_all_cores(work, rows.shape[0], progress)


def _on_all_cores(
    work: Callable[[slice], None],
    count: int,
    progress: Callable[[float], None] | None = None,
) -> None:
    """Does the work chunk by chunk; the kernel releases the interpreter's lock."""
    done = 0
    with ThreadPoolExecutor(max_workers=os.cpu_count()) as pool:
        parts = [slice(start, min(start + CHUNK, count)) for start in range(0, count, CHUNK)]
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
) -> tuple[Array, Array]:
    """(cable force F_c in N, source power in W) within a cycle of gaits from the start, as `simulator.simulate` has it.

    ``stroke`` m and ``frequency`` Hz of shape (n,); ``cycle`` counts from 0; ``phases`` (m,) in [0, 1], ascending, are
    shares of it. Both results have the shape (n, m); NaN where the simulator gave up (chatter).
    """
    gaits = np.broadcast_arrays(*np.atleast_1d(stroke, frequency, float(direction), 0.0))
    rows = _gait_rows([np.asarray(column, dtype=float) for column in gaits])
    shares, row = np.asarray(phases, dtype=float), parameter_row(parameters)
    force, length_rate = np.empty((2, rows.shape[0], shares.size))

    def work(part: slice) -> None:
        run.sample_many(rows[part], row, cycle, shares, force[part], length_rate[part])

    _on_all_cores(work, rows.shape[0])
    mechanical = cable_power(force, length_rate, parameters.one_sided_cable)
    return force, parameters.idle_power + parameters.power_factor * mechanical


def _table(
    columns: list[Array], parameter_rows: Array, results: Array, shape: tuple[int, ...]
) -> GaitTable:
    def parameter(key: str) -> Array:
        values = parameter_rows[:, KEYS.index(key)]
        return np.broadcast_to(values, (results.shape[0],)).reshape(shape)

    stroke, frequency, direction, margin = columns
    advance = results[:, run.MEAN_ADVANCE].reshape(shape)
    power = results[:, run.MEAN_POWER].reshape(shape)
    pitch, initial_length = parameter("pitch"), parameter("initial_length")
    speed = advance * frequency
    mass = parameter("rear_mass") + parameter("front_mass")
    return GaitTable(
        stroke=stroke,
        frequency=frequency,
        direction=direction,
        margin=margin,
        speed=speed,
        power=power,
        cost_of_transport=cost_of_transport(speed, power, mass),
        grooves_per_cycle=advance / pitch,
        min_grooves=results[:, run.LEAST_ADVANCE].reshape(shape) / pitch,
        groove_phase=initial_length - nearest_groove(initial_length, pitch) * pitch,
        switches=results[:, run.RUN_SWITCHES].reshape(shape).astype(np.int64),
    )
