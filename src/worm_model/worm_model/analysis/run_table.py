# SPDX-License-Identifier: Apache-2.0
"""Table of a recorded run in seconds since the gait's onset, for notebooks and spreadsheets."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from worm_model.analysis.replay_metrics import run_end
from worm_model.analysis.run_metrics import played_gaits
from worm_model.analysis.run_parts import parts_of
from worm_model.errors import InputError
from worm_model.run import Run, Stamps, power_status_name, seconds, state_name

Column = NDArray[Any]
_LENGTHS = ("commanded", "cable", "measured", "estimated")


@dataclass(frozen=True)
class RunTable:
    """Columns of equal length by name. Values are not interpolated.

    The name of a quantity ends in its unit.

    Each row is a moment at which something was measured or commanded, in the order of the stamps. Values without a
    sample at that moment are NaN, or None for texts. The first columns are

    - ``time_s``: time since the onset of the row's gait; without any gait, since the first sample;
    - ``gait``: number of the gait in the recording, from 1; 0 without a gait. A gait includes the rest before it
      and the time after it. A gait with inadmissible values has no rows, but a number;
    - ``cycle``: number of the cycle, from 1; 0 before the gait and after its end;
    - ``stamp_ns``: acquisition stamp, ns since the epoch.
    """

    columns: dict[str, Column]

    def to_dataframe(self) -> Any:
        """Return a pandas.DataFrame with these columns; raise `InputError` if pandas is not installed."""
        try:
            from pandas import DataFrame
        except ImportError:
            raise InputError("a data frame needs pandas: pip install pandas") from None
        return DataFrame(self.columns)


def run_table(run: Run) -> RunTable:
    """Return all samples of a run in one table; samples of one source with equal stamps have separate rows."""
    series = [(stamp, columns) for stamp, columns in _series(run) if stamp.size]
    keys = [np.stack([stamp, _repetition(stamp)], axis=1) for stamp, _ in series]
    all_keys = np.concatenate(keys) if keys else np.empty((0, 2), np.int64)
    unique, row = np.unique(all_keys, axis=0, return_inverse=True)
    rows = np.split(row.reshape(-1), np.cumsum([len(key) for key in keys])[:-1])
    table = _time_columns(run, unique[:, 0])
    for own, (_, columns) in zip(rows, series, strict=False):
        for name, values in columns.items():
            missing = None if values.dtype == object else np.nan
            table[name] = np.full(len(unique), missing, values.dtype)
            table[name][own] = values
    return RunTable(table)


def _repetition(stamp: Stamps) -> Stamps:
    """Return the number of earlier samples with the same stamp for each sample."""
    order = np.argsort(stamp, kind="stable")
    ordered = stamp[order]
    repetition = np.empty_like(stamp)
    repetition[order] = np.arange(stamp.size) - np.searchsorted(ordered, ordered)
    return repetition


def _time_columns(run: Run, stamp: Stamps) -> dict[str, Column]:
    """Return the columns ``time_s``, ``gait``, ``cycle`` and ``stamp_ns``, which have a value in each row."""
    gait, cycle = np.zeros(stamp.size, np.int64), np.zeros(stamp.size, np.int64)
    time = seconds(stamp, run.origin)
    for number, part in enumerate(parts_of(run), 1):
        for played in played_gaits(part.run.gait_state)[-1:]:
            own = (stamp >= part.start) & (stamp < part.end)
            gait[own], time[own] = number, seconds(stamp[own], played.onset)
            moving = own & (stamp >= played.onset) & (stamp < run_end(part.run, played))
            cycle[moving] = 1 + np.floor(time[moving] / played.gait.period).astype(np.int64)
    return {"time_s": time, "gait": gait, "cycle": cycle, "stamp_ns": stamp}


def _series(run: Run) -> Iterator[tuple[Stamps, dict[str, Column]]]:
    """Yield the stamps of each source, and the source's columns by name."""
    states, power, tracker, joints = run.gait_state, run.power, run.tracker, run.joint_states
    yield states.stamp, {"state": _texts([state_name(state) for state in states.state.tolist()])}
    for name in _LENGTHS:
        samples = getattr(run, name)
        columns = {"length_m": samples.length, "length_change_m": samples.length_change}
        yield samples.stamp, {f"{name}_{column}": values for column, values in columns.items()}
    yield tracker.stamp, {"x1_m": tracker.rear_position, "x2_m": tracker.front_position}
    yield (
        power.stamp,
        {
            "power_W": power.valid_power,
            "bus_voltage_V": power.bus_voltage,
            "current_A": power.current,
            "power_status": _texts([power_status_name(status) for status in power.status.tolist()]),
        },
    )
    quantities = {
        "position_rad": joints.position,
        "velocity_rad_s": joints.velocity,
        "effort_Nm": joints.effort,
    }
    yield (
        joints.stamp,
        {
            f"{joint}_{quantity}": values[:, index]
            for index, joint in enumerate(joints.names)
            for quantity, values in quantities.items()
            if values.shape[1:] == (len(joints.names),)
        },
    )


def _texts(values: list[str]) -> Column:
    return np.array(values, dtype=object)
