# SPDX-License-Identifier: Apache-2.0
"""Changes of the core's record between two calls of the core; all other modules of this folder only read it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from worm_model.run import PLAYING, Activity
from worm_model.twin.core.memory import NANOSECONDS, POSITION, Memory
from worm_model.twin.data.samples import DriverState, driver_state_of
from worm_model.twin.findings import Finding
from worm_model.twin.start_estimate import EstimatedStart
from worm_model.twin.twin_settings import TwinSettings
from worm_msgs.gait import WAVEFORM, Gait


def apply_settings(m: Any, settings: TwinSettings) -> None:
    """Store the settings. ``m`` is the record, here and below."""
    m["delay"] = round(settings.delay_s * NANOSECONDS)
    m["usual_size"] = settings[1:]


def next_driver_state(memory: Memory) -> DriverState:
    """Take the driver state at which the core has stopped."""
    m: Any = memory.record[0]
    driver = driver_state_of(memory.rows[int(m["place"])])
    m["place"] += 1
    return driver


def store_driver_state(m: Any, driver: DriverState) -> None:
    """Store the activity of the driver."""
    if driver.activity == Activity.RESTING != m["activity"]:
        m["rest_ns"] = driver.stamp_ns
    m["activity"] = driver.activity
    if driver.activity in PLAYING:
        m["reported_cycle"] = driver.cycle


def begin_run(
    memory: Memory,
    driver: DriverState,
    standing: Mapping[str, Any],
    start_ns: int,
    command: float,
    cycle: int,
) -> None:
    """Begin a run with its first driver state.

    Args:
        memory: the twin's memory.
        driver: first driver state of the run.
        standing: fields of the record that describe the robot at the beginning of the run.
        start_ns: stamp from which the twin follows the run, later than the onset if it joins late.
        command: u_cmd at this time, m.
        cycle: number of the cycle at this time, 0 without a gait.
    """
    m: Any = memory.record[0]
    gait = driver.gait
    for name, value in standing.items():
        m[name] = value
    m["run"], m["start_ns"], m["end_ns"] = driver.run, driver.onset_ns, 0
    m["has_gait"] = gait is not None
    m["engaged"], m["command_ns"], m["command"] = 1, start_ns, command
    m["moved"], m["blind_s"], m["warning"], m["warned_until"] = 0, 0.0, 0, 0
    m["instrument_ns"], m["instrument_power"], m["instrument_energy"] = start_ns, math.nan, 0.0
    m["cycle"], m["cycle_end_ns"], m["cycle_groove"] = cycle, 0, 0
    memory.sums[:] = 0.0
    if gait is not None:
        for name in WAVEFORM:
            m[name] = getattr(gait, name)
        m["cycle_end_ns"] = _end_of_cycle(m, gait)
    m["edge_slack"] = 0.0
    # At the onset the twin resets its position to the tracker's, so earlier position residuals no longer count.
    _forget_position_residuals(m)


def close_cycle(memory: Memory, gait: Gait) -> None:
    """Begin the next cycle of a run."""
    m: Any = memory.record[0]
    memory.sums[:] = 0.0
    m["blind_s"], m["cycle_groove"] = 0.0, m["rear_groove"]
    m["cycle"] += 1
    m["cycle_end_ns"] = _end_of_cycle(m, gait)


def shift_origin(m: Any, finding: Finding) -> None:
    """Follow a finding: move both anchors by its grooves, and the origin by its shift; take over its L0."""
    m["moved"] += finding.grooves
    m["origin"] += finding.shift
    if finding.explains_position:
        _forget_position_residuals(m)
    if math.isfinite(finding.initial_length):
        m["initial_length"], m["length_fitted"] = finding.initial_length, 1


def continue_from(m: Any, found: EstimatedStart) -> None:
    """Replace the motion by the one from an estimated start."""
    motion, start = found.motion, found.start
    m["origin"] += m["pose_x1"] - start.x1
    m["pose_x1"], m["pose_front"], m["moved"] = start.x1, start.front_groove, 0
    m["y"], m["y_rate"] = motion.y, motion.y_rate
    for name in ("rear_groove", "front_groove", "rear_region", "front_region"):
        m[name] = getattr(motion, name)


def end_run(m: Any, stamp_ns: int, *, is_usable: bool) -> None:
    """End the running run. After one that cannot be judged, the position of the robot is unknown."""
    m["cycle_end_ns"], m["end_ns"] = 0, stamp_ns
    if not is_usable:
        m["start_ns"] = 0


def warn(m: Any, number: int, gait: Gait) -> None:
    """Let a warning affect the health until the end of the next cycle."""
    m["warning"] = number
    m["warned_until"] = int(m["cycle_end_ns"]) + round(gait.period * NANOSECONDS)


def set_start_known(m: Any, *, known: bool) -> None:
    """State whether the state of the fins at the onset is known."""
    m["start_known"] = known


def excuse_groove(m: Any, pitch: float) -> None:
    """Ignore position residuals up to a groove for the health, because the gait is near an edge."""
    m["edge_slack"] = pitch


def keep_counts(m: Any, before: Any) -> None:
    """Take over settings and the number of samples by fate from the record before a restart."""
    for name in ("counts", "delay", "usual_size"):
        m[name] = before[name]


def _end_of_cycle(m: Any, gait: Gait) -> int:
    return int(m["start_ns"]) + round(int(m["cycle"]) * gait.period * NANOSECONDS)


def _forget_position_residuals(m: Any) -> None:
    m["channel_ns"][POSITION] = m["channel_level"][POSITION] = 0
