# SPDX-License-Identifier: Apache-2.0
"""Import of a lab's raw logs, one CSV file per instrument, as a run.

A run's folder contains ``camera.csv`` (time_s, x1_m, x2_m; an empty position is an occluded marker), ``power.csv``
(time_s, bus_voltage_V, current_A) and ``servo.csv`` (time_s, goal_ticks; positive ticks shorten the body; in a gait
with pretension, 0 is the goal without tension). At least one of these files is required. Times are s of one clock for
all files. ``runs.json`` in the folder or next to it contains each run's gait: stroke_m, frequency_Hz, and fields
that differ from their defaults, such as direction, margin_m and pretension_m.
"""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from worm_model.arrays import Array
from worm_model.checksum import sha256_of
from worm_model.errors import IdentificationError
from worm_model.parameters import PAPER
from worm_model.run import (
    Activity,
    GaitStates,
    LengthSamples,
    PowerSamples,
    Run,
    Stamps,
    TrackerSamples,
)
from worm_model.simulation.actuation import resting_change
from worm_msgs.gait import GAIT_COLUMNS, GAIT_DEFAULTS, Gait, GaitError, gait_of

TICKS_PER_TURN = 4096  # Dynamixel X series, ROBOTIS e-manual
FILES = {
    "camera.csv": ("time_s", "x1_m", "x2_m"),
    "power.csv": ("time_s", "bus_voltage_V", "current_A"),
    "servo.csv": ("time_s", "goal_ticks"),
}
GAITS_FILE = "runs.json"
USUAL_ONSET = 2.0  # s after the start of the logs, used if the logs do not show the onset
LONGEST_DAYS = (
    30  # longest accepted recording; a longer one has times of several clocks or in another unit
)
LONGEST = LONGEST_DAYS * 86400  # s
SECOND = 10**9  # ns
MOST = 1e100  # largest accepted number, whose square is finite
LATEST = 2**31 * SECOND  # ns since 1970, end of the stamps of ROS (year 2038)
CONTRACTION_STEPS = 2000  # number of points of the gait's contraction, for finding the onset
USUAL_SPOOL = 0.012  # m, used if the logs do not show the spool radius
# Relative difference between the given and the estimated radius above which a remark reports it
SPOOL_TOLERANCE = 2e-3
FEWEST_MOVED = 10  # smallest number of goals for an estimate of the onset or of the radius
# Ticks, smallest range of the goals for an estimate of the radius. The rounding error of the radius is then at most
# half a percent.
FEWEST_TICKS = 200


@dataclass(frozen=True)
class LabSettings:
    """Data that the logs do not contain.

    Attributes:
        epoch: stamp of t = 0, ns since 1970; None: the logs start at a stamp of 1 s, as 0 would mean "unknown".
        onset: start of the gait, s; None: the time at which the servo's goal begins to move; without such a time in the
            servo's log, `USUAL_ONSET`.
        spool_radius: spool radius of the cable servo, m; None: estimated from the servo's goals and the gait's
            stroke; if they do not suffice, `USUAL_SPOOL`.
        initial_length: L0, m; None: median of the camera's lengths before the onset, minus the length change that the
            pretension causes on the paper's robot; without such lengths, the paper's L0.
    """

    epoch: int | None = None
    onset: float | None = None
    spool_radius: float | None = None
    initial_length: float | None = None


@dataclass(frozen=True)
class LabRun:
    """Imported run of a lab.

    Attributes:
        run: its samples.
        gait: the gait of the run; None if the folder does not contain it.
        initial_length: L0, the reference of the length changes, m.
        checksums: SHA-256 of the source files, by name.
        onset: stamp of the gait's onset, ns since 1970, given or estimated.
        spool_radius: m, given or estimated.
        remarks: remarks on the source of onset and spool radius.
    """

    run: Run
    gait: Gait | None
    initial_length: float
    checksums: Mapping[str, str]
    onset: int
    spool_radius: float
    remarks: tuple[str, ...]


def read_lab_run(folder: Path, settings: LabSettings) -> LabRun:
    """Read a run's folder."""
    if not folder.is_dir():
        raise IdentificationError(f"{folder} is not a folder; expected one with {', '.join(FILES)}")
    tables = {
        name: read_table(folder / name, columns)
        for name, columns in FILES.items()
        if (folder / name).exists()
    }
    if not tables:
        raise IdentificationError(f"{folder} holds none of {', '.join(FILES)}")
    camera, power, servo = (
        tables.get(name, dict.fromkeys(columns, np.empty(0))) for name, columns in FILES.items()
    )
    gait = read_gait(folder)
    clock = _clock(folder, tables, settings)
    onset, began = _onset(servo, gait, settings, clock.start)
    radius, wound = _spool(servo, gait, settings)
    length = _initial_length(camera, settings, onset, gait)
    stamp = int(clock.stamps(np.array(onset)))
    run = Run(
        origin=clock.origin,
        commanded=_commanded(servo, length, clock, radius),
        measured=_measured(camera, length, clock),
        tracker=TrackerSamples(clock.stamps(camera["time_s"]), camera["x1_m"], camera["x2_m"]),
        power=_power(power, clock),
        gait_state=GaitStates() if gait is None else _gait_states(gait, clock, onset, stamp),
    )
    checksums = {name: sha256_of(folder / name) for name in tables}
    return LabRun(run, gait, length, checksums, stamp, radius, (*began, *wound))


@dataclass(frozen=True)
class _Clock:
    """Clock of the logs: ``start`` (whole s) and ``end`` (s) of all logs, and ``origin``, the stamp of ``start`` in ns.

    The differences to ``start`` are converted, because those to a distant epoch do not fit into 64 bits.
    """

    start: int
    end: float
    origin: int

    def stamps(self, times: Array) -> Stamps:
        """Return the stamps of times in s, in ns since 1970."""
        return self.origin + np.rint((times - self.start) * 1e9).astype(np.int64)


def _clock(folder: Path, tables: Mapping[str, Table], settings: LabSettings) -> _Clock:
    """Return the clock of the logs. Raises an error if the times, the onset and the epoch do not fit to each other."""
    times = {name: table["time_s"][[0, -1]].tolist() for name, table in tables.items()}
    start, end = math.floor(min(times.values())[0]), max(last for _, last in times.values())
    onset = start if settings.onset is None else settings.onset
    if max(end, onset) - min(start, onset) > LONGEST:
        spans = ", ".join(f"{name} from {a:.10g} to {b:.10g} s" for name, (a, b) in times.items())
        raise IdentificationError(
            f"{folder}: more than {LONGEST_DAYS} days between the times ({spans}; onset {onset:.10g} s): give all in s "
            "of one clock"
        )
    if settings.epoch is None:
        return _Clock(start, end, SECOND)
    origin = settings.epoch + start * SECOND
    if not 0 <= origin <= LATEST - LONGEST * SECOND:
        raise IdentificationError(
            f"{folder}: times from {start} to {end:.10g} s with --epoch {settings.epoch / SECOND:.10g} lie before 1970 "
            "or after 2038, for which ROS has no stamps; give --epoch 0 if the times are s since 1970"
        )
    return _Clock(start, end, origin)


def _onset(
    servo: Table, gait: Gait | None, settings: LabSettings, start: float
) -> tuple[float, list[str]]:
    """Return the onset (s): the given one, else that of the servo's goals, else the usual one, with a remark on it."""
    if settings.onset is not None:
        return settings.onset, []
    found = _onset_of(servo, gait)
    onset = start + USUAL_ONSET if found is None else found
    source = "assumed" if found is None else "where the servo's goal begins to move"
    return onset, [f"gait from {onset:.2f} s on, {source}"]


def _spool(servo: Table, gait: Gait | None, settings: LabSettings) -> tuple[float, list[str]]:
    """Return the spool radius (m): the given one, else that of the servo's goals, else the usual one, with remarks.

    A remark states the source of a value that was not given, or reports a given radius that contradicts the goals.
    """
    found, given = _spool_of(servo, gait) if gait else None, settings.spool_radius
    if given is None:
        radius = USUAL_SPOOL if found is None else found
        source = "assumed" if found is None else "for which the servo's goals produce the stroke"
        return radius, [f"spool radius {1e3 * radius:.2f} mm, {source}"]
    if found is None or abs(given / found - 1.0) <= SPOOL_TOLERANCE:
        return given, []
    return given, [
        f"spool radius {1e3 * given:.2f} mm as given, but the servo's goals produce the gait's stroke with "
        f"{1e3 * found:.2f} mm: radius or stroke is wrong, and K has the same relative error"
    ]


def _onset_of(table: Table, gait: Gait | None) -> float | None:
    """Return the time (s) at which the goal begins to move from its rest before the gait.

    With a known gait, the first goals that have moved are extrapolated back along the gait's contraction, which begins
    as a parabola. The result is None if fewer than `FEWEST_MOVED` goals have moved.
    """
    if table["time_s"].size < FEWEST_MOVED:
        return None
    moved = _contraction(table["goal_ticks"], gait)
    rows = np.flatnonzero(moved > 0.5)[:FEWEST_MOVED]
    if rows.size < FEWEST_MOVED:
        return None
    if gait is None:
        return float(table["time_s"][rows[0]])
    share = np.minimum(moved[rows] / np.nanmax(moved), 1.0)
    times = np.linspace(0.0, gait.contraction_share * gait.period, CONTRACTION_STEPS)
    shares = -(gait.command(times) + gait.pretension) / gait.stroke
    since = np.interp(share, shares, times)
    return float(np.median(table["time_s"][rows] - since))


def _contraction(goal_ticks: Array, gait: Gait | None) -> Array:
    """Return the ticks by which the goals exceed the goal at rest; negative until the gait's pretension is reached."""
    if gait is None or gait.pretension == 0.0:
        return np.abs(goal_ticks - goal_ticks[0])
    ticks = np.abs(goal_ticks)
    # The rounding of the greatest goal makes the goal at rest uncertain by less than a tick.
    return ticks - math.ceil(float(np.nanmax(ticks)) * gait.pretension / gait.reach)


def _spool_of(table: Table, gait: Gait) -> float | None:
    """Return the radius (m) for which the goals produce a gait's stroke, or None if the goals do not suffice.

    The log must contain at least `FEWEST_MOVED` rows and one period of the gait. The goals must cover a range of at
    least `FEWEST_TICKS`.

    The radius is rounded to a tenth of a millimetre if the rounding of the goals permits this value.
    """
    goals = table["goal_ticks"][np.isfinite(table["goal_ticks"])]
    time = table["time_s"]
    if goals.size < FEWEST_MOVED or time[-1] - time[0] < gait.period:
        return None
    ticks = float(np.ptp(np.append(goals, 0.0) if gait.pretension else goals))
    if ticks < FEWEST_TICKS:
        return None
    low, middle, high = (
        gait.reach / (2.0 * math.pi * (ticks + rounding) / TICKS_PER_TURN)
        for rounding in (1.0, 0.0, -1.0)
    )
    whole = round(middle, 4)
    return whole if low <= whole <= high else middle


Table = Mapping[str, NDArray[np.float64]]


def read_table(path: Path, columns: tuple[str, ...]) -> Table:
    """Return the columns of a CSV file by name; an empty cell is NaN. The first column is the time, which must rise."""
    table = read_columns(path, columns)
    time = table[columns[0]]
    wrong = np.flatnonzero(~(np.diff(time) > 0.0))
    if not np.isfinite(time).all() or len(wrong):
        line = int(wrong[0]) + 3 if len(wrong) else 2
        raise IdentificationError(f"{path}, near line {line}: {columns[0]} does not rise")
    return table


def read_columns(path: Path, columns: tuple[str, ...]) -> Table:
    """Return the columns of a CSV file by name; an empty cell is NaN. The order of the rows does not matter."""
    try:
        with path.open(encoding="utf-8-sig", newline="") as stream:
            reader = csv.DictReader(stream)
            header = [name.strip() for name in reader.fieldnames or []]
            reader.fieldnames = header
            missing = [name for name in columns if name not in header]
            if missing:
                raise IdentificationError(
                    f"{path} has no column {missing[0]}; its first line is {','.join(header)!r}"
                )
            rows = [
                [_number(row[name], path, reader.line_num, name) for name in columns]
                for row in reader
            ]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise IdentificationError(f"{path} cannot be read: {error}") from None
    if not rows:
        raise IdentificationError(f"{path} has no rows")
    values = np.array(rows)
    return {name: values[:, index] for index, name in enumerate(columns)}


def _number(text: str | None, path: Path, line: int, name: str) -> float:
    if text is None:
        raise IdentificationError(f"{path}, line {line}: {name} is missing: the line is cut off")
    try:
        value = float(text) if text.strip() else math.nan
    except ValueError:
        raise IdentificationError(
            f"{path}, line {line}: {name} is {text!r}, not a number"
        ) from None
    if abs(value) > MOST:
        raise IdentificationError(
            f"{path}, line {line}: {name} is {value:g}; numbers are at most {MOST:g}"
        )
    return value


def read_gait(folder: Path) -> Gait | None:
    """Return the gait of a run's folder from runs.json, None without such a file."""
    path = next(
        (p for p in (folder / GAITS_FILE, folder.resolve().parent / GAITS_FILE) if p.is_file()),
        None,
    )
    if path is None:
        return None
    name = folder.resolve().name
    try:
        entry: Any = json.loads(path.read_text(encoding="utf-8"))[name]
        given = {
            name: entry[column]
            for name, column in GAIT_COLUMNS.items()
            if name not in GAIT_DEFAULTS or column in entry
        }
        return gait_of(given)
    except KeyError as error:
        raise IdentificationError(f"{path} lacks {error} of {name}") from None
    except GaitError as error:
        raise IdentificationError(f"{path}: the gait of {name} is invalid: {error}") from None
    except (OSError, ValueError, TypeError, AttributeError) as error:
        raise IdentificationError(f"{path} is not a list of gaits by run: {error}") from None


def _initial_length(camera: Table, settings: LabSettings, onset: float, gait: Gait | None) -> float:
    if settings.initial_length is not None:
        return settings.initial_length
    lengths = (camera["x2_m"] - camera["x1_m"])[camera["time_s"] < onset]
    known = lengths[np.isfinite(lengths)]
    if not known.size:
        return PAPER.initial_length
    return float(np.median(known)) - (0.0 if gait is None else resting_change(gait, PAPER))


def _commanded(table: Table, initial_length: float, clock: _Clock, radius: float) -> LengthSamples:
    turns = table["goal_ticks"] / TICKS_PER_TURN
    change = -turns * 2.0 * math.pi * radius
    present = np.isfinite(change)
    stamp = clock.stamps(table["time_s"])
    return LengthSamples(stamp[present], initial_length + change[present], change[present])


def _measured(table: Table, initial_length: float, clock: _Clock) -> LengthSamples:
    """Return the length samples as the tracker publishes them, without the rows with an occluded marker."""
    length = table["x2_m"] - table["x1_m"]
    known = np.isfinite(length)
    stamp = clock.stamps(table["time_s"])
    return LengthSamples(stamp[known], length[known], length[known] - initial_length)


def _power(table: Table, clock: _Clock) -> PowerSamples:
    voltage, current = table["bus_voltage_V"], table["current_A"]
    power = voltage * current
    bus_error = 3  # Power.BUS_ERROR, for a line of the log without a reading
    status = np.where(np.isfinite(power), 0, bus_error)
    stamp = clock.stamps(table["time_s"])
    return PowerSamples(stamp, status.astype(np.int64), voltage, current, power)


def _gait_states(gait: Gait, clock: _Clock, onset: float, onset_stamp: int) -> GaitStates:
    """Return the states that the driver would publish: at rest from the start, then one at each cycle's start."""
    cycles = max(math.ceil((clock.end - onset) * gait.frequency), 0)
    begins = onset + np.arange(cycles) / gait.frequency
    stamp = clock.stamps(np.concatenate([[clock.start], begins]))
    cycle = np.arange(cycles + 1)
    return GaitStates.of(
        gait,
        stamp,
        state=np.where(cycle == 0, Activity.RESTING, Activity.RUNNING),
        onset=np.where(cycle == 0, 0, onset_stamp),
        cycle=cycle,
        cycles=np.full(cycles + 1, cycles),
    )
