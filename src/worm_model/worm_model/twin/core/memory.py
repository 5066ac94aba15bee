# SPDX-License-Identifier: Apache-2.0
"""State of the twin between two samples, in arrays of fixed size, and the rows of the core's output."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from worm_model.simulation.kernel.march import SAMPLE_COLUMNS, TOTALS_SIZE
from worm_model.twin.data.records import RESIDUAL_ROW, STATE_ROW
from worm_model.twin.data.samples import SAMPLE, SampleKind
from worm_msgs.gait import GAIT_UNITS, WAVEFORM, Gait, gait_of

NANOSECONDS = 1_000_000_000
KINDS = len(SampleKind)
# The kinds as plain integers, for compiled code.
GAIT_KIND, COMMAND_KIND, LENGTH_KIND, POSITION_KIND, POWER_KIND = (int(kind) for kind in SampleKind)
CHANNELS = 3  # quantities with a residual: position, length, power
POSITION, LENGTH, POWER = range(CHANNELS)
ROOM = 16384  # rows of recent and waiting samples: some 3 s of five topics at 1 kHz
# Largest number of held samples, see `sample_buffer`. This many confirm each other even if all are of one topic.
HELD = 100
PHASES = 200  # bins of a cycle in which residuals are summed
REST_S = 1.0  # time before the onset over which rest pose and initial length are averaged
SMOOTHING_S = (
    0.15  # half the time over which a parabola is fitted to measured lengths for their rate
)
SMOOTHING_NS = round(SMOOTHING_S * NANOSECONDS)
# Between measured lengths further apart than this, the length follows from the command. The computation at a row also
# uses samples that are later than the row by up to this time, which is longer than the smoothing.
LOOK_AHEAD_NS = 200_000_000

# Fates of a sample; CROWDED means that `rows` is full. `counts` contains the number of samples by fate.
ACCEPTED, DUPLICATE, LATE, AHEAD, NOT_A_NUMBER, CROWDED = range(6)
# Names of the fates in outputs
VERDICTS = ("taken", "duplicate", "late", "ahead", "not a number", "crowded")

# Columns of `Memory.sums`: sum and number of the residuals of each channel.
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
    """Field of the record with ``entries`` values. A stamp of 0 means that there is no such stamp."""

    name: str
    kind: type[np.generic]
    unit: str
    meaning: str
    entries: int = 1


FIELDS = (
    # settings
    Field("delay", np.int64, "ns", "`TwinSettings.delay_s`"),
    Field("usual_size", np.float64, "m, m, W", "scales of the `TwinSettings`", CHANNELS),
    # samples
    Field("present", np.int64, "ns", "newest stamp of all samples except driver states"),
    Field("newest", np.int64, "ns", "newest stamp by kind of sample", KINDS),
    Field("old_in_a_row", np.int64, "1", "successive samples older than the newest by `jump_back`"),
    Field("ahead", np.int64, "1", "number of samples in `held`"),
    Field("filled", np.int64, "1", "number of used rows of `rows`"),
    Field("place", np.int64, "1", "index in `rows` of the next row to process"),
    Field("processed_ns", np.int64, "ns", "stamp of the last processed row"),
    Field("counts", np.int64, "1", "number of samples by fate", len(VERDICTS)),
    # command, and the response of the length to it
    Field("activity", np.int64, "1", "last reported Activity of the driver, −1 before any"),
    Field("rest_ns", np.int64, "ns", "stamp at which the driver last began to rest for a run"),
    Field("pulling", np.int64, "1", "1 if the last command contracts the cable noticeably"),
    Field("released_ns", np.int64, "ns", "stamp of the first command after the last such one"),
    Field("command_ns", np.int64, "ns", "stamp of `command` and `answer`"),
    Field("command", np.float64, "m", "u_cmd"),
    Field("answer", np.float64, "m", "ΔL that the actuation model computes from the command"),
    Field("engaged", np.int64, "1", "1 from the first onset on: ΔL answers the command"),
    Field("answered", np.int64, "1", "1 if the answer is known at the row being processed"),
    # motion
    Field("moving", np.int64, "1", "1 once the motion is computed, also while the robot rests"),
    Field("motion_ns", np.int64, "ns", "stamp up to which the motion is computed"),
    Field("length_change", np.float64, "m", "ΔL at `motion_ns`"),
    Field(
        "y",
        np.float64,
        "m",
        "x1 + μ·ΔL with μ = M2/(M1 + M2), relative to the run's first rear groove",
    ),
    Field("y_rate", np.float64, "m/s", "rate of y"),
    Field("rear_groove", np.int64, "1", "rear anchor, counted from the run's first rear groove"),
    Field("front_groove", np.int64, "1", "front anchor, counted from the run's first rear groove"),
    Field("rear_region", np.int64, "1", "region of the rear fin (kernel.mode)"),
    Field("front_region", np.int64, "1", "region of the front fin"),
    Field("source", np.int64, "1", "LengthSource of the length that drives the motion"),
    Field("drives", np.int64, "1", "1 if the row being processed drives the motion"),
    Field("arrived", np.int64, "1", "1 if the motion has reached the row being processed"),
    Field("on_estimate", np.int64, "1", "1 if `answer` drove the motion up to `motion_ns`"),
    Field("measured_ns", np.int64, "ns", "stamp of the last measured length"),
    Field("track_ns", np.int64, "ns", "stamp at which the twin was last put at rest"),
    Field("track_change", np.float64, "m", "ΔL at `track_ns`"),
    Field("published_ns", np.int64, "ns", "stamp of the last published state"),
    Field("estimated_ns", np.int64, "ns", "stamp of the last published estimated length"),
    # power
    Field("power_ns", np.int64, "ns", "stamp of `power` and `energy`"),
    Field("power", np.float64, "W", "predicted source power"),
    Field("power_variance", np.float64, "W²", "variance of `power` due to noise of the lengths"),
    Field("energy", np.float64, "J", "predicted energy since `track_ns`"),
    Field("instrument_ns", np.int64, "ns", "stamp of the last measured power, or start of the run"),
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
    Field("length_seen", np.int64, "1", "1 if an instrument measured `initial_length`"),
    Field("length_fitted", np.int64, "1", "1 if `initial_length` was estimated from the motion"),
    Field(
        "origin",
        np.float64,
        "m",
        "position of the run's first rear groove in the tracker's coordinates",
    ),
    Field("origin_known", np.int64, "1", "1 if the tracker has measured `origin`"),
    Field("pose_x1", np.float64, "m", "x1 before the run, relative to the rear anchor"),
    Field("pose_front", np.int64, "1", "front anchor before the run, in grooves from the rear one"),
    Field("edge_slack", np.float64, "m", "position residual that does not affect the health"),
    # While this is 0, residuals of position and power do not affect the health.
    Field("start_known", np.int64, "1", "1 if the state of the fins at the onset is known"),
    Field("moved", np.int64, "1", "grooves to add to both anchors, along +x"),
    Field("cycle", np.int64, "1", "number of the cycle, from 1; 0 without a gait"),
    Field("cycle_end_ns", np.int64, "ns", "end of the cycle"),
    Field("cycle_groove", np.int64, "1", "`rear_groove` at the beginning of the cycle"),
    Field("reported_cycle", np.int64, "1", "cycle in the driver's last message during a gait"),
    Field("blind_s", np.float64, "s", "part of the cycle without data about the length"),
    Field("paused_ns", np.int64, "ns", "stamp at which the last gap was reported"),
    # residuals by channel
    Field("channel_ns", np.int64, "ns", "stamp of the last residual", CHANNELS),
    Field(
        "channel_square",
        np.float64,
        "1",
        "mean of residual² / (usual size² + variance of the noise)",
        CHANNELS,
    ),
    Field("channel_level", np.int64, "1", "Health of the channel", CHANNELS),
    Field("level_ns", np.int64, "ns", "last stamp that justified `channel_level`", CHANNELS),
    Field("noise_count", np.int64, "1", "number of residuals in `noise_square`", CHANNELS),
    Field("noise_square", np.float64, "m², m², W²", "variance of the noise", CHANNELS),
    Field("noise_last", np.float64, "m, m, W", "last residual", CHANNELS),
    Field("noise_before", np.float64, "m, m, W", "residual before the last", CHANNELS),
    Field("warning", np.int64, "1", "number of the last warning"),
    Field("warned_until", np.int64, "ns", "end of the effect of `warning` on the health"),
    # positions
    Field("accepted_ns", np.int64, "ns", "stamp of `accepted`"),
    Field("accepted", np.float64, "m", "last accepted position of the rear module"),
    Field("rejected_ns", np.int64, "ns", "stamp of `rejected`"),
    Field("rejected", np.float64, "m", "first rejected position of a jump"),
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
        held: samples that are implausibly far ahead of all others, shape (HELD,) of SAMPLE.
        sums: sums of the running cycle's residuals, shape (PHASES, SUMS).
        totals: totals of the kernel's `march`, shape (TOTALS_SIZE,).
        sample: the kernel's sample at `motion_ns`, shape (1, SAMPLE_COLUMNS).
    """

    record: NDArray[np.void]
    rows: NDArray[np.void]
    held: NDArray[np.void]
    sums: NDArray[np.float64]
    totals: NDArray[np.float64]
    sample: NDArray[np.float64]


def gait_of_run(record: Any) -> Gait:
    """Return the gait in a record of the memory, without the margin. The record must contain one (``has_gait``)."""
    return gait_of({name: record[name] for name in (*WAVEFORM, "direction")})


class OutputRows(NamedTuple):
    """Room for the output.

    ``counts`` (4,) contains the numbers of used rows of ``states``, ``residuals``, ``lengths`` and ``events``.
    """

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
