# SPDX-License-Identifier: Apache-2.0
"""All that the twin remembers between two samples, in a record of fixed size, and the rows that it puts out."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from worm_model.gait import WAVEFORM
from worm_model.simulation.kernel.march import SAMPLE_COLUMNS, TOTALS_SIZE
from worm_model.twin.records import RESIDUAL_ROW, STATE_ROW
from worm_model.twin.samples import SAMPLE

NANOSECONDS = 1_000_000_000
KINDS = 5
CHANNELS = 3  # of residuals: position, length, power
POSITION, LENGTH, POWER = range(CHANNELS)
ROOM = 16384  # samples of the recent past and of those that are not taken yet: some 3 s of five topics at 1 kHz
PATIENCE = 100  # samples ahead in a row, which one stream alone may convince with
PHASES = 200  # of a cycle, in which its samples are summed up

# What becomes of a sample; `counts` has one number of each.
TAKEN, DUPLICATE, LATE, AHEAD, NOT_A_NUMBER, CROWDED = range(6)
VERDICTS = ("taken", "duplicate", "late", "ahead", "not a number", "crowded")

# Columns of the sums of a cycle: what was measured minus predicted, and how often.
(
    POSITION_SUM,
    POSITION_COUNT,
    LENGTH_SUM,
    LENGTH_COUNT,
    POWER_SUM,
    POWER_COUNT,
) = range(6)
SUMS = 6

_WHOLE = """
    present old_in_a_row ahead filled place taken_ns activity
    command_ns engaged
    measured_ns on_estimate moving motion_ns track_ns source answered arrived drives
    rear_groove front_groove rear_region front_region switched
    power_ns
    run start_ns end_ns has_gait direction length_seen length_fitted origin_known start_known pose_front moved
    cycle cycle_end_ns told_cycle
    instrument_ns warned_until warning
    sight_ns refused_ns published_ns estimated_ns
    paused_ns
"""
_REAL = """
    command answer length_change y y_rate track_change
    power power_variance energy
    initial_length origin pose_x1
    instrument_power instrument_energy
    sight refused event_value blind_s
"""
MEMORY = np.dtype(
    [
        *((name, np.int64) for name in _WHOLE.split()),
        *((name, np.float64) for name in (*_REAL.split(), *WAVEFORM)),
        ("newest", np.int64, (KINDS,)),
        ("counts", np.int64, (len(VERDICTS),)),
        ("channel_ns", np.int64, (CHANNELS,)),
        ("channel_level", np.int64, (CHANNELS,)),
        ("level_ns", np.int64, (CHANNELS,)),
        ("channel_square", np.float64, (CHANNELS,)),
        ("noise_count", np.int64, (CHANNELS,)),
        ("noise_square", np.float64, (CHANNELS,)),
        ("noise_last", np.float64, (CHANNELS,)),
        ("noise_before", np.float64, (CHANNELS,)),
    ]
)
LENGTH_ROW = np.dtype(
    [("stamp_ns", np.int64), ("length", np.float64), ("length_change", np.float64)]
)


class Memory(NamedTuple):
    """``record`` (1,) of MEMORY; ``rows`` and ``held`` of SAMPLE; ``sums`` (PHASES, SUMS) of the running cycle.

    In ``record``, by what it is for: taking samples (``present`` newest stamp of the instruments, ``filled`` rows
    of which those from ``place`` on are not taken yet, ``taken_ns``); the answer to the command (``command`` u_cmd in
    m at ``command_ns``, ``answer`` ΔL in m); the motion at ``motion_ns`` in the frame of the run's first rear groove;
    the run (``origin``: the tracker's position of that groove in m, ``moved``: grooves by which the robot is found
    further along +x than the motion alone would have it, ``start_known``: whether its fins stand as the twin has
    them; else residuals of position and power do not count for the health); the residuals by channel (mean square in
    usual sizes; that of their noise in the channel's unit); the tracker's last accepted position and the first refused
    one. Stamps in ns, 0: none. ``totals`` and ``sample`` are the kernel's.
    """

    record: NDArray[np.void]
    rows: NDArray[np.void]
    held: NDArray[np.void]
    sums: NDArray[np.float64]
    totals: NDArray[np.float64]
    sample: NDArray[np.float64]


class Rules(NamedTuple):
    """The settings as the core needs them: times in ns but for ``smoothing`` in s, scales of residuals, gate in m."""

    delay: int
    look_ahead: int
    stale: int
    pause: int
    jump_back: int
    hold_ahead: int
    jump_ahead: int
    history: int
    period: int
    moved: int
    smoothing: float
    gate: float
    position_scale: float
    length_scale: float
    power_scale: float


class Rows(NamedTuple):
    """Room for what comes out; ``counts`` (3,) are the rows used of each."""

    states: NDArray[np.void]
    residuals: NDArray[np.void]
    lengths: NDArray[np.void]
    counts: NDArray[np.int64]


def new_memory(initial_length: float, front_groove: int) -> Memory:
    """The memory before any sample; L0 in m, and the front anchor in grooves from the rear one."""
    record = np.zeros(1, MEMORY)
    first: Any = record[0]
    first["activity"], first["direction"], first["pose_front"] = -1, 1, front_groove
    first["initial_length"] = initial_length
    for name in ("sight", "refused", "instrument_power", "instrument_energy"):
        first[name] = np.nan
    return Memory(
        record,
        np.zeros(ROOM, SAMPLE),
        np.zeros(PATIENCE, SAMPLE),
        np.zeros((PHASES, SUMS)),
        np.zeros(TOTALS_SIZE),
        np.zeros((1, SAMPLE_COLUMNS)),
    )


def new_rows(count: int) -> Rows:
    """Room for what so many samples may yield."""
    return Rows(
        np.empty(count, STATE_ROW),
        np.empty(count, RESIDUAL_ROW),
        np.empty(count, LENGTH_ROW),
        np.zeros(3, np.int64),
    )
