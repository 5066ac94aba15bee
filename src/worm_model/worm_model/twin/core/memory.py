# SPDX-License-Identifier: Apache-2.0
"""State of the twin between two samples, in a record of fixed size, and the rows of its output."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from worm_model.gait import GAIT_UNITS, WAVEFORM
from worm_model.simulation.kernel.march import SAMPLE_COLUMNS, TOTALS_SIZE
from worm_model.twin.records import RESIDUAL_ROW, STATE_ROW
from worm_model.twin.samples import SAMPLE, Kind

NANOSECONDS = 1_000_000_000
KINDS = len(Kind)
# The kinds as plain integers, for compiled code.
GAIT_KIND, COMMAND_KIND, LENGTH_KIND, POSITION_KIND, POWER_KIND = (int(kind) for kind in Kind)
CHANNELS = 3  # of residuals
POSITION, LENGTH, POWER = range(CHANNELS)
ROOM = 16384  # rows of recent and waiting samples: some 3 s of five topics at 1 kHz
HELD = 100  # samples ahead of the others after which one topic alone is sufficient evidence
PHASES = 200  # bins of a cycle in which residuals are summed

# Fates of a sample; `counts` has the number of samples with each.
ACCEPTED, DUPLICATE, LATE, AHEAD, NOT_A_NUMBER, CROWDED = range(6)
VERDICTS = ("taken", "duplicate", "late", "ahead", "not a number", "crowded")

# Columns of the sums of a cycle: sum and number of the residuals of each channel.
(
    POSITION_SUM,
    POSITION_COUNT,
    LENGTH_SUM,
    LENGTH_COUNT,
    POWER_SUM,
    POWER_COUNT,
) = range(6)
SUMS = 6


class Field(NamedTuple):
    """Field of the record with ``entries`` values. Stamps are in ns, with 0 for none."""

    name: str
    kind: type[np.generic]
    unit: str
    meaning: str
    entries: int = 1


FIELDS = (
    # samples
    Field("present", np.int64, "ns", "newest stamp of the instruments"),
    Field("newest", np.int64, "ns", "newest stamp of each kind of sample", KINDS),
    Field("old_in_a_row", np.int64, "1", "successive samples older than a jump of the clock"),
    Field("ahead", np.int64, "1", "samples in `held`"),
    Field("filled", np.int64, "1", "used rows of `rows`"),
    Field("place", np.int64, "1", "next row of `rows` to process"),
    Field("processed_ns", np.int64, "ns", "stamp of the last processed row"),
    Field("counts", np.int64, "1", "number of samples by fate", len(VERDICTS)),
    # command, and the response of the length to it
    Field("activity", np.int64, "1", "last reported Activity of the driver, −1 before any"),
    Field("command_ns", np.int64, "ns", "stamp of the command"),
    Field("command", np.float64, "m", "u_cmd"),
    Field("answer", np.float64, "m", "ΔL according to the actuation model"),
    Field("engaged", np.int64, "1", "1 after the onset of the first run"),
    Field("answered", np.int64, "1", "1 if the answer is known at the row being processed"),
    # motion
    Field("moving", np.int64, "1", "1 once the motion has begun"),
    Field("motion_ns", np.int64, "ns", "stamp of the motion"),
    Field("length_change", np.float64, "m", "ΔL that drives the motion"),
    Field("y", np.float64, "m", "x1 + μ·ΔL from the run's first rear groove"),
    Field("y_rate", np.float64, "m/s", "rate of y"),
    Field("rear_groove", np.int64, "1", "rear anchor in grooves from the run's first rear groove"),
    Field("front_groove", np.int64, "1", "front anchor in grooves from the same groove"),
    Field("rear_region", np.int64, "1", "region of the rear fin (kernel.mode)"),
    Field("front_region", np.int64, "1", "region of the front fin"),
    Field("source", np.int64, "1", "LengthSource of the driving length"),
    Field("drives", np.int64, "1", "1 if the row being processed drives the motion"),
    Field("arrived", np.int64, "1", "1 if the motion has reached the row being processed"),
    Field("on_estimate", np.int64, "1", "1 if the answer to the command drives the motion"),
    Field("measured_ns", np.int64, "ns", "stamp of the last measured length"),
    Field("track_ns", np.int64, "ns", "stamp at which the motion began from rest"),
    Field("track_change", np.float64, "m", "ΔL at that stamp"),
    Field("published_ns", np.int64, "ns", "stamp of the last published state"),
    Field("estimated_ns", np.int64, "ns", "stamp of the last published estimated length"),
    # power
    Field("power_ns", np.int64, "ns", "stamp of the power"),
    Field("power", np.float64, "W", "predicted source power"),
    Field("power_variance", np.float64, "W²", "variance of the prediction due to measured lengths"),
    Field("energy", np.float64, "J", "predicted energy of the run"),
    Field("instrument_ns", np.int64, "ns", "stamp of the last measured power"),
    Field("instrument_power", np.float64, "W", "last measured power"),
    Field("instrument_energy", np.float64, "J", "measured energy of the run"),
    # run
    Field("run", np.int64, "1", "number of the run, 0 if unknown"),
    Field("start_ns", np.int64, "ns", "onset of the run"),
    Field("end_ns", np.int64, "ns", "end of the run"),
    Field("has_gait", np.int64, "1", "1 if the driver reported the gait"),
    Field("direction", np.int64, "1", "direction for which the fins are set"),
    *(Field(name, np.float64, GAIT_UNITS[name], f"{name} of the gait") for name in WAVEFORM),
    Field("initial_length", np.float64, "m", "L0 of the run"),
    Field("length_seen", np.int64, "1", "1 if an instrument measured L0"),
    Field("length_fitted", np.int64, "1", "1 if L0 was estimated from the motion"),
    Field("origin", np.float64, "m", "the tracker's position of the run's first rear groove"),
    Field("origin_known", np.int64, "1", "1 if the tracker has measured it"),
    Field("pose_x1", np.float64, "m", "x1 at rest from the run's first rear groove"),
    Field("pose_front", np.int64, "1", "front anchor at rest in grooves from the rear one"),
    Field(
        "start_known", np.int64, "1", "1 if the fins started as modelled; else nothing is judged"
    ),
    Field("moved", np.int64, "1", "grooves along +x by which the robot is further than predicted"),
    Field("cycle", np.int64, "1", "number of the cycle, from 1"),
    Field("cycle_end_ns", np.int64, "ns", "end of the cycle"),
    Field("reported_cycle", np.int64, "1", "cycle in the driver's last message"),
    Field("blind_s", np.float64, "s", "time of the cycle without data about the length"),
    Field("paused_ns", np.int64, "ns", "stamp of the last reported gap"),
    # residuals by channel
    Field("channel_ns", np.int64, "ns", "stamp of the last residual", CHANNELS),
    Field("channel_square", np.float64, "1", "mean square in usual sizes", CHANNELS),
    Field("channel_level", np.int64, "1", "Health of the channel", CHANNELS),
    Field("level_ns", np.int64, "ns", "stamp from which that level holds", CHANNELS),
    Field("noise_count", np.int64, "1", "residuals in the estimate of the noise", CHANNELS),
    Field("noise_square", np.float64, "m², m², W²", "variance of the noise", CHANNELS),
    Field("noise_last", np.float64, "m, m, W", "last residual", CHANNELS),
    Field("noise_before", np.float64, "m, m, W", "residual before the last", CHANNELS),
    Field("warning", np.int64, "1", "number of the last warning"),
    Field("warned_until", np.int64, "ns", "end of that warning's effect on the health"),
    # positions
    Field("accepted_ns", np.int64, "ns", "stamp of the last accepted position"),
    Field("accepted", np.float64, "m", "last accepted position"),
    Field("rejected_ns", np.int64, "ns", "stamp of the first rejected position of a jump"),
    Field("rejected", np.float64, "m", "that position"),
)
MEMORY = np.dtype(
    [
        (field.name, field.kind, (field.entries,))
        if field.entries > 1
        else (field.name, field.kind)
        for field in FIELDS
    ]
)
LENGTH_ROW = np.dtype(
    [("stamp_ns", np.int64), ("length", np.float64), ("length_change", np.float64)]
)
#: Event of the core: ``kind`` and ``value`` as in `worm_model.twin.core.estimator`.
EVENT_ROW = np.dtype([("kind", np.int64), ("stamp_ns", np.int64), ("value", np.float64)])


class Memory(NamedTuple):
    """State of the twin.

    Attributes:
        record: fields of `FIELDS`, shape (1,).
        rows: samples ordered by stamp, shape (ROOM,) of SAMPLE.
        held: samples that are ahead of the others, shape (HELD,) of SAMPLE.
        sums: sums of the running cycle's residuals, shape (PHASES, SUMS).
        totals: totals of the kernel.
        sample: last sample of the kernel, shape (1, SAMPLE_COLUMNS).
    """

    record: NDArray[np.void]
    rows: NDArray[np.void]
    held: NDArray[np.void]
    sums: NDArray[np.float64]
    totals: NDArray[np.float64]
    sample: NDArray[np.float64]


class Rules(NamedTuple):
    """Settings for the core: times in ns except ``smoothing`` in s, scales of residuals, gate in m."""

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


class OutputRows(NamedTuple):
    """Room for the output; ``counts`` (4,) has the number of used rows of each."""

    states: NDArray[np.void]
    residuals: NDArray[np.void]
    lengths: NDArray[np.void]
    events: NDArray[np.void]
    counts: NDArray[np.int64]


def new_memory(initial_length: float, front_groove: int) -> Memory:
    """Return the state before any sample, for L0 in m and the front anchor in grooves from the rear one."""
    record = np.zeros(1, MEMORY)
    first: Any = record[0]
    first["activity"], first["direction"], first["pose_front"] = -1, 1, front_groove
    first["initial_length"] = initial_length
    for name in ("accepted", "rejected", "instrument_power", "instrument_energy"):
        first[name] = np.nan
    return Memory(
        record,
        np.zeros(ROOM, SAMPLE),
        np.zeros(HELD, SAMPLE),
        np.zeros((PHASES, SUMS)),
        np.zeros(TOTALS_SIZE),
        np.zeros((1, SAMPLE_COLUMNS)),
    )


def new_rows(count: int) -> OutputRows:
    """Return room for the output of a number of samples."""
    return OutputRows(
        np.empty(count, STATE_ROW),
        np.empty(count, RESIDUAL_ROW),
        np.empty(count, LENGTH_ROW),
        np.empty(count, EVENT_ROW),
        np.zeros(4, np.int64),
    )
