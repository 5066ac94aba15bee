# SPDX-License-Identifier: Apache-2.0
"""Estimate of the fins' state at the beginning of a gait, from the positions during the first cycle.

The twin uses this estimate if the state is unknown. A gait leaves the fins deflected and the modules off their grooves,
which affects the first cycle of the next gait. The exact model computes the motion from each possible pose at rest,
with the measured ΔL or the ΔL that the actuation model expects. The estimate is the pose whose motion agrees best with
the tracker's positions.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from worm_model.arrays import Array
from worm_model.parameters import Parameters
from worm_model.simulation.actuation import length_change_of_command, resting_change
from worm_model.simulation.closed_form import front_groove
from worm_model.simulation.simulator import Locomotion, LocomotionState, SimulationError
from worm_model.twin.core.memory import NANOSECONDS, Memory, gait_of_run
from worm_model.twin.data.samples import SampleKind

FIT_M = 0.0012  # largest root mean square of the residuals at which a start explains the positions
STEP_M = 0.001  # step between the tested offsets of the rear module from its groove
REACH = 1.0  # largest of these offsets, in pitches; the rear fin switches at about this offset
SAME_M = 0.0002  # distance below which two poses count as one
FEWEST = 20  # smallest number of positions in the cycle
LEAST_RATE_HZ = 5.0  # smallest rate of measured lengths from which the motion can be computed
REST_S = 1.0  # time after which a robot that starts with a tested offset is at rest


@dataclass(frozen=True)
class Start:
    """Pose at rest: x1 relative to the rear anchor in m, and the front anchor in grooves from the rear anchor."""

    x1: float
    front_groove: int


@dataclass(frozen=True)
class EstimatedStart:
    """Start that explains a cycle.

    Attributes:
        start: the pose at rest.
        motion: motion at the end of the cycle, in the frame of the start's rear anchor.
        misfit: root mean square of the position residuals, m.
    """

    start: Start
    motion: LocomotionState
    misfit: float


def estimate_start(memory: Memory, parameters: Parameters, end_ns: int) -> EstimatedStart | None:
    """Return the start of the running gait, estimated from the samples since its onset.

    ``parameters`` contain the run's L0. The memory must contain the run's gait. The motion is computed up to
    ``end_ns``. The result is None if the samples do not suffice, or if no start explains the positions.
    """
    m = memory.record[0]
    onset = int(m["start_ns"])
    rows = memory.rows[: int(m["place"])]
    if not len(rows) or rows["stamp"][0] > onset:
        return None  # the memory no longer contains the onset
    rows = rows[(rows["stamp"] > onset) & (rows["stamp"] <= end_ns)]
    seen = rows[(rows["kind"] == SampleKind.POSITION) & np.isfinite(rows["a"])]
    if len(seen) < FEWEST:
        return None
    times, changes = _drive(m, rows, parameters, (end_ns - onset) / NANOSECONDS)
    at = (seen["stamp"] - onset) / NANOSECONDS
    asked = np.unique(np.concatenate([times, at]))
    driven = np.interp(asked, times, changes)
    places = np.searchsorted(asked, at)
    rest_x1 = float(m["origin"]) + float(m["pose_x1"])
    measured = seen["a"] - rest_x1
    model = Locomotion(parameters, int(m["direction"]))
    best: EstimatedStart | None = None
    for pose, motion in _poses(model, parameters, float(changes[0])):
        try:
            final, motions = model.follow(motion, motion.time + asked[1:], driven[1:])
        except SimulationError:
            continue
        path = np.concatenate([[pose.x1], motions.x1])[places] - pose.x1
        misfit = float(np.sqrt(np.mean((path - measured) ** 2)))
        if best is None or misfit < best.misfit:
            best = EstimatedStart(pose, final, misfit)
    return best if best is not None and best.misfit <= FIT_M else None


def _drive(
    m: Any, rows: np.ndarray, parameters: Parameters, duration: float
) -> tuple[Array, Array]:
    """Return times (s) from 0 to the duration, and ΔL (m) at these times, measured or computed from the commands."""
    onset = int(m["start_ns"])
    gait = gait_of_run(m)
    # A twin that was put at rest after the onset does not store ΔL at the onset.
    known = int(m["track_ns"]) <= onset
    start = float(m["track_change"]) if known else resting_change(gait, parameters)
    lengths = rows[rows["kind"] == SampleKind.LENGTH]
    if len(lengths) >= LEAST_RATE_HZ * duration:
        times = (lengths["stamp"] - onset) / NANOSECONDS
        changes = lengths["a"] - parameters.initial_length
    else:
        commands = rows[rows["kind"] == SampleKind.COMMAND]
        times = (commands["stamp"] - onset) / NANOSECONDS
        knots = np.concatenate([[0.0], times])
        changes = length_change_of_command(
            knots, np.concatenate([[gait.command(0.0)], commands["a"]]), parameters, start
        )[1:]
    times, changes = np.concatenate([[0.0], times]), np.concatenate([[start], changes])
    inside = times < duration
    last = float(m["length_change"])
    return np.append(times[inside], duration), np.append(changes[inside], last)


def _poses(
    model: Locomotion, parameters: Parameters, change: float
) -> list[tuple[Start, LocomotionState]]:
    """Return the distinct poses in which a body with a given ΔL (m) can rest, each with its motion at time 0."""
    pitch, usual = parameters.pitch, front_groove(parameters)
    reach = math.ceil(REACH * pitch / STEP_M)
    found: list[tuple[Start, LocomotionState]] = []
    for front in (usual, usual - 1, usual + 1):
        for k in range(-reach, reach + 1):
            try:
                motion = model.start(0.0, change, k * STEP_M, front)
                motion, _ = model.follow(motion, [REST_S], [change])
            except SimulationError:
                continue
            over = motion.rear_groove
            pose = Start(model.x1(motion) - over * pitch, motion.front_groove - over)
            if abs(pose.x1) > REACH * pitch or any(
                other.front_groove == pose.front_groove and abs(other.x1 - pose.x1) < SAME_M
                for other, _ in found
            ):
                continue
            found.append((pose, model.start(0.0, change, pose.x1, pose.front_groove)))
    return found
