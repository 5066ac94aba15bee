# SPDX-License-Identifier: Apache-2.0
"""The motion under the driving lengths of a stretch, its power and energy: `worm_model.twin.track` in columns."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from worm_model.parameters import Parameters
from worm_model.simulation.kernel.recording_loops import pick_settled
from worm_model.simulation.quadrature import accumulated
from worm_model.simulation.simulator import Locomotion, LocomotionState
from worm_model.simulation.smoothing import smooth
from worm_model.twin.offline.drive import Drive
from worm_model.twin.offline.sample_timeline import Array, Rows
from worm_model.twin.records import NANOSECONDS
from worm_model.twin.track import (
    SETTLE_STEP_S,
    Row,
    Track,
    power_at_rate,
)
from worm_model.twin.twin_settings import TwinSettings

COLUMNS = Row._fields[1:10]  # of x1 to chord_force


@dataclass(frozen=True)
class Motion:
    """The twin at the driving lengths: COLUMNS by name as `worm_model.twin.track.Row` has them, each (rows,).

    ``drive`` is what moved it; ``rate`` (m/s), ``power`` (W) and ``energy`` (J) as known at once, ``final_power`` and
    ``final_energy`` as settled; ``settled`` the last settled row at each flush; ``end`` the motion at the last row.
    """

    drive: Drive
    columns: dict[str, Array]
    rate: Array
    power: Array
    energy: Array
    final_power: Array
    final_energy: Array
    settled: Rows
    end: LocomotionState


def follow_lengths(drive: Drive, track: Track, model: Locomotion, settings: TwinSettings) -> Motion:
    """The motion from the track's only row, which is row 0.

    Raises:
        SimulationError: chatter.
    """
    time = (drive.stamp - drive.stamp[0]) / NANOSECONDS
    columns = {name: np.full(len(time), getattr(track.rows[0], name)) for name in COLUMNS}
    end = track.motion
    if len(time) > 1:
        mu = model.parameters.front_mass / model.parameters.mass
        end, moved = model.follow(end, time[1:], drive.length_change[1:])
        y_rate = moved.v1 + mu * moved.length_rate
        values = (
            *(moved.x1, moved.x2, y_rate, moved.rear_force, moved.front_force),
            *(moved.rear_groove, moved.front_groove, moved.length_rate, moved.cable_force),
        )
        for name, value in zip(COLUMNS, values, strict=True):
            columns[name][1:] = value
    settled = _settled(drive, settings)
    rate = _rates_at_once(drive, time, columns["chord_rate"], settings)
    rate[0] = track.rows[0].rate
    final = _final_rates(drive, time, rate, int(settled.max(initial=0)), settings)
    power, final_power = (_power(columns, values, model.parameters) for values in (rate, final))
    return Motion(
        drive=drive,
        columns=columns,
        rate=rate,
        power=power,
        energy=accumulated(time, power),
        final_power=final_power,
        final_energy=accumulated(time, final_power),
        settled=settled,
        end=end,
    )


def _power(columns: dict[str, Array], rate: Array, parameters: Parameters) -> Array:
    power: Array = power_at_rate(columns["chord_force"], columns["chord_rate"], rate, parameters)
    return power


def _settled(drive: Drive, settings: TwinSettings) -> Rows:
    settled = np.empty(len(drive.flush_row), np.intp)
    half, step = round(settings.smoothing_s * NANOSECONDS), round(SETTLE_STEP_S * NANOSECONDS)
    pick_settled(drive.stamp, drive.measured, drive.flush_row, half, step, settled)
    return settled


def _rates_at_once(drive: Drive, time: Array, chord: Array, settings: TwinSettings) -> Array:
    """Exact where the estimate drives; of measured lengths that of the newest of their flush, from the past alone."""
    rows = np.flatnonzero(drive.measured)
    rate = np.where(drive.measured, chord, drive.rate)
    if not len(rows):
        return rate
    newest = drive.flush_row
    last = newest[np.searchsorted(newest, rows)] if len(newest) else rows
    # A flush whose newest length is an estimate leaves its measured ones the slope of their line.
    asked = newest[drive.measured[newest]]
    window = 2.0 * settings.smoothing_s
    found = smooth(time[rows], drive.length_change[rows], time[asked], window, 0.0).rate
    known = np.where(np.isfinite(found), found, chord[asked])
    at = np.full(len(time), np.nan)
    at[asked] = known
    rate[rows] = np.where(np.isfinite(at[last]), at[last], chord[rows])
    return rate


def _final_rates(
    drive: Drive, time: Array, at_once: Array, last: int, settings: TwinSettings
) -> Array:
    """Of measured lengths up to the last settled row from both sides."""
    rate = at_once.copy()
    rows = np.flatnonzero(drive.measured)
    asked = rows[(rows > 0) & (rows <= last)]
    if len(asked):
        half = settings.smoothing_s
        found = smooth(time[rows], drive.length_change[rows], time[asked], half, half).rate
        rate[asked] = np.where(np.isfinite(found), found, rate[asked])
    return rate
