# SPDX-License-Identifier: Apache-2.0
"""Changes of the core's record between two calls of the core, apart from the begin of a run (`run_start.begin_run`).

All other modules of this folder only read the record, which is ``m`` below.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from worm_model.run import PLAYING, Activity
from worm_model.twin.core.memory import NANOSECONDS, POSITION, Memory
from worm_model.twin.data.samples import DriverState, driver_state_of
from worm_model.twin.start_estimate import EstimatedStart
from worm_msgs.gait import Gait


def use_settings(m: Any, delay_s: float, usual_sizes: Sequence[float]) -> None:
    """Take over the settings of the twin that the core needs: the delay, and the usual sizes of the residuals."""
    m["delay"] = round(delay_s * NANOSECONDS)
    m["usual_size"] = usual_sizes


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


def close_cycle(memory: Memory, gait: Gait) -> None:
    """Begin the next cycle of a run."""
    m: Any = memory.record[0]
    memory.sums[:] = 0.0
    m["blind_s"], m["cycle_groove"] = 0.0, m["rear_groove"]
    m["cycle"] += 1
    m["cycle_end_ns"] = end_of_cycle(m, gait)


def end_of_cycle(m: Any, gait: Gait) -> int:
    """Return the end (ns) of the present cycle of a gait."""
    return int(m["start_ns"]) + round(int(m["cycle"]) * gait.period * NANOSECONDS)


def shift_origin(m: Any, grooves: int, shift: float, *, explained: bool) -> None:
    """Move both anchors by ``grooves``, and the origin by ``shift`` (m).

    If this is ``explained``, earlier position residuals no longer count.
    """
    m["moved"] += grooves
    m["origin"] += shift
    if explained:
        m["channel_ns"][POSITION] = m["channel_level"][POSITION] = 0


def fit_length(m: Any, initial_length: float) -> None:
    """Take over an L0 (m) that the motion shows; NaN: none."""
    if math.isfinite(initial_length):
        m["initial_length"], m["length_fitted"] = initial_length, 1


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


def keep(m: Any, before: Any) -> None:
    """Take over the counts of samples and the settings from the record before a restart."""
    for name in ("counts", "delay", "usual_size"):
        m[name] = before[name]
