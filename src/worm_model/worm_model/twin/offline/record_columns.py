# SPDX-License-Identifier: Apache-2.0
"""The twin's output of a stretch as columns, one per field of its records."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from worm_model.parameters import Parameters
from worm_model.simulation.closed_form import groove_phase
from worm_model.simulation.kernel.recording_loops import remember_residuals
from worm_model.twin.by_sample import Series
from worm_model.twin.offline.cycles import Finding
from worm_model.twin.offline.instrument_comparison import Observations
from worm_model.twin.offline.motion import Motion
from worm_model.twin.offline.sample_timeline import Array, Rows, Stamps
from worm_model.twin.records import Health, LengthSource
from worm_model.twin.residuals import (
    FAULTY_FROM,
    LENGTH,
    MEMORY_S,
    POSITION,
    POWER,
    SILENT_S,
    SUSPECT_FROM,
    Channel,
    Monitor,
    judge,
)
from worm_model.twin.track import force_at_rate
from worm_model.twin.twin_settings import TwinSettings
from worm_model.twin.twin_state import Run

CHANNELS = (POSITION, LENGTH, POWER)


# --- states ---------------------------------------------------------------------------------------


def state_columns(
    motion: Motion, run: Run, moved: NDArray[np.int64], origin: Array, p: Parameters
) -> Series:
    """StateRecords at the start and at each flush: anchors ``moved`` by grooves, the twin's zero at ``origin`` m."""
    drive = motion.drive
    row = np.append(0, drive.flush_row)
    settled = np.append(0, motion.settled)
    of = {name: values[row] for name, values in motion.columns.items()}
    rate, change, mu = motion.rate[row], drive.length_change[row], p.front_mass / p.mass
    zero = origin + moved * p.pitch
    count = len(row)
    source = np.where(drive.measured[row], LengthSource.MEASURED, LengthSource.ESTIMATED)
    return {
        "stamp_ns": drive.stamp[row],
        "length_source": source,
        "initial_length": np.full(count, p.initial_length),
        "groove_phase": np.full(count, groove_phase(p)),
        "length": p.initial_length + change,
        "length_rate": rate,
        "rear_position": zero + of["x1"],
        "front_position": zero + of["x2"],
        "rear_velocity": of["y_rate"] - mu * rate,
        "front_velocity": of["y_rate"] + (1.0 - mu) * rate,
        "rear_anchor": zero + of["rear_groove"] * p.pitch,
        "front_anchor": zero + of["front_groove"] * p.pitch,
        "rear_groove": of["rear_groove"].astype(np.int64) + moved,
        "front_groove": of["front_groove"].astype(np.int64) - run.pose.front_groove + moved,
        "cable_force": force_at_rate(of["chord_force"], of["chord_rate"], rate, p),
        "rear_fin_force": of["rear_force"],
        "front_fin_force": of["front_force"],
        "power": motion.power[row],
        "energy": motion.final_energy[settled] + motion.energy[row] - motion.energy[settled],
    }


# --- residuals ------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Judged:
    """Observations of one channel.

    ``residual`` is for the record, ``fault`` what of it counts for the health (NaN: nothing), m or W; ``energy`` in
    J, of power only; each (observations,).
    """

    seen: Observations
    residual: Array
    fault: Array
    energy: Array


def residual_columns(
    judged: Sequence[Judged], findings: Sequence[Finding], monitor: Monitor, settings: TwinSettings
) -> tuple[Series, tuple[str, ...], Monitor]:
    """(ResidualRecords but for their messages, these, the monitor in the end); ``judged`` in the order of CHANNELS."""
    place = np.concatenate([one.seen.place for one in judged])
    trigger = np.concatenate([one.seen.trigger for one in judged])
    order = np.lexsort((place, trigger))
    place, trigger = place[order], trigger[order]
    channel = np.concatenate([np.full(len(one.residual), c) for c, one in enumerate(judged)])
    stamp = np.concatenate([one.seen.stamp for one in judged])[order]
    scales = (settings.position_scale_m, settings.length_scale_m, settings.power_scale_W)
    square = np.concatenate([(j.fault / s) ** 2 for j, s in zip(judged, scales, strict=True)])
    nan = np.full(len(stamp), np.nan)
    columns: Series = {"stamp_ns": stamp}
    names = ("rear_position", "length", "power")
    for c, (name, scale) in enumerate(zip(names, scales, strict=True)):
        values = np.where(channel == c, np.concatenate([j.residual for j in judged]), nan)
        columns[name], columns[f"{name}_scale"] = values[order], np.full(len(stamp), scale)
    columns["energy"] = np.concatenate([one.energy for one in judged])[order]
    begins = [_first_record(finding, place, trigger) for finding in findings]
    size, monitor = _remember(
        channel[order], stamp, square[order], list(zip(begins, findings, strict=True)), monitor
    )
    texts = ("", *(finding.text for finding in findings))
    columns["health"], messages = _health(size, _warnings(findings, begins, stamp), texts)
    return columns, messages, monitor


def _first_record(finding: Finding, place: Rows, trigger: Rows) -> int:
    """First record that a finding counts for: that of the observation which told, or the first after the comparison."""
    at, row = finding.closing, finding.closing.row
    first = int(np.searchsorted(trigger, at.trigger, side="right"))
    if row is None:
        return first
    same = slice(int(np.searchsorted(trigger, at.trigger)), first)
    return same.start + int(np.searchsorted(place[same], at.place))


def _remember(
    channel: NDArray[np.int64],
    stamp: Stamps,
    square: Array,
    findings: Sequence[tuple[int, Finding]],
    monitor: Monitor,
) -> tuple[Array, Monitor]:
    """(size of each channel at each record in usual ones, the monitor in the end)."""
    before, after = np.zeros((2, len(stamp) + 1), np.bool_)
    for row, finding in findings:
        if finding.move is not None:
            (before if finding.closing.row is None else after)[row] = True
    known = [monitor.channels.get(name, Channel(0, math.nan)) for name in CHANNELS]
    newest = np.array([one.stamp_ns for one in known])
    mean = np.array([one.mean_square for one in known])
    size = np.empty((len(stamp), len(CHANNELS)))
    spans = np.array([MEMORY_S, SILENT_S])
    remember_residuals(channel, stamp, square, before[:-1], after[:-1], spans, newest, mean, size)
    if before[-1]:
        newest[0] = 0
    channels = {
        name: Channel(int(newest[c]), float(mean[c]))
        for c, name in enumerate(CHANNELS)
        if newest[c]
    }
    return size, replace(monitor, channels=channels)


def _warnings(findings: Sequence[Finding], begins: Sequence[int], stamp: Stamps) -> Rows:
    """The finding that is a warning at each record, numbered from 1, or 0."""
    warned = np.zeros(len(stamp), np.intp)
    for number, (begin, finding) in enumerate(zip(begins, findings, strict=True), 1):
        warned[begin:] = np.where(stamp[begin:] <= finding.until_ns, number, 0)
    return warned


def _health(
    size: Array, warned: Rows, texts: Sequence[str]
) -> tuple[NDArray[np.int64], tuple[str, ...]]:
    """(health of each record, its message), the warning's text among ``texts``."""
    healthy = np.isfinite(size).any(axis=1)
    level = np.where(healthy, Health.HEALTHY, Health.UNKNOWN).astype(np.int64)
    messages = [""] * len(level)
    told: dict[tuple[str, int, bytes], tuple[Health, str]] = {}
    complaints = (size > SUSPECT_FROM).any(axis=1) | (warned > 0)
    tenths = np.rint(10.0 * np.where(size > SUSPECT_FROM, size, 0.0))
    faulty = np.count_nonzero(size > FAULTY_FROM, axis=1)
    for row in np.flatnonzero(complaints).tolist():
        warning = texts[warned[row]]
        key = warning, int(faulty[row]), tenths[row].tobytes()
        if key not in told:
            heard = np.isfinite(size[row])
            sizes = {name: float(size[row, c]) for c, name in enumerate(CHANNELS) if heard[c]}
            told[key] = judge(sizes, warning)
        level[row], messages[row] = told[key]
    return level, tuple(messages)
