# SPDX-License-Identifier: Apache-2.0
"""Start of a run: rest pose, initial length, and the state in which the previous run left the fins.

All samples before the onset have been processed when the run starts.

- The position of the rear module is the mean of the tracker's positions during the last `REST_S` seconds.
- L0 is the mean length of the same time span: the measured body length or, without it, x2 − x1 of the tracker. If there
  is no plausible length, L0 is that of the previous run if it was measured or estimated, and otherwise the parameter.
- The first run starts with straight fins, or with fins that only load and pretension deflect.
- After a run the fins stay deflected, so that the modules are up to some millimetres off their grooves. The next run
  starts in this state.
- While the cable is at rest, the body returns to its initial length. Fins that are turned for the other direction move
  to the nearest grooves. If they are turned shortly after a pull, the body is still shorter by the effect of the slack
  (K·δ_s), which may change these grooves. If the twin cannot determine the grooves, the start is unknown.
- A pretension o shortens the body by K·max(o, δ_s). L0 is then the measured length plus this amount, and ΔL starts at
  minus this amount.
- If a body at rest is shorter by the effect of the slack, the slack is still taken up. L0 then remains that of the
  previous run, and ΔL starts at the measured difference from L0.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from worm_model.parameters import Parameters
from worm_model.run import PLAYING, SAME_ONSET_NS, is_another_run
from worm_model.simulation.actuation import length_change_of_command, resting_change
from worm_model.simulation.closed_form import front_groove
from worm_model.simulation.simulator import Locomotion, LocomotionState, SimulationError
from worm_model.twin.core.memory import NANOSECONDS, POSITION, REST_S, Memory
from worm_model.twin.data.samples import DriverState, SampleKind
from worm_model.twin.record_changes import end_of_cycle
from worm_model.twin.start_estimate import Start
from worm_msgs.gait import FORWARD, WAVEFORM, Gait

# A twin that joins a run at most this long after the onset does not report the delay.
LATE_S = 0.02
PLAUSIBLE_M = 0.02  # largest plausible difference between a measured L0 and the parameter
# Tolerance for the length change of a body whose slack is taken up, relative to the effect of the slack.
TIGHTENED = 0.35
FEWEST = 5  # smallest number of samples for a mean
# Values at rest may differ by STILL_M plus STILL_NOISE times the median difference of consecutive values.
STILL_M, STILL_NOISE = 0.0005, 5.0
# Samples closer to the onset than this are ignored, because the clocks of driver and instruments may differ.
GUARD_NS = 100_000_000
TAUT_NS = 500_000_000  # time after a pull in which the slack has certainly not returned
SLACK_NS = 2_000_000_000  # longest time after a pull until the slack has returned
# Largest deviations from the place where the previous run left the robot, modulo the pitch
TOLERANCE = 0.3  # pitches; beyond this, the robot was moved between the runs
SURE_M = 0.002  # beyond this, the state of the fins is uncertain
JOIN_STEP_S = 0.01  # time step at which a late twin computes the commands that it missed


def is_new_run(m: Any, driver: DriverState) -> bool:
    """Return True if a driver state is the first one of a run; ``m`` is the record of the memory."""
    if driver.activity not in PLAYING or driver.onset_ns <= 0:
        return False
    if not m["start_ns"] or not m["has_gait"]:
        return True
    if m["end_ns"] and abs(driver.onset_ns - int(m["start_ns"])) > SAME_ONSET_NS:
        return True  # a restarted driver, which counts its runs from 1 again
    before = int(m["run"]), int(m["reported_cycle"]), int(m["start_ns"])
    return bool(is_another_run(before, (driver.run, driver.cycle, driver.onset_ns)))


def begin_run(
    memory: Memory,
    driver: DriverState,
    parameters: Parameters,
    starts: Mapping[int, Start],
) -> tuple[int, str]:
    """Initialize a run in the memory.

    If the twin has already passed the onset, because the driver's message or the twin was late, the run starts at the
    current stamp and position. The gait then determines the present ΔL.

    Args:
        memory: the twin's memory, updated in place.
        driver: first driver state of the run.
        parameters: parameters of the robot.
        starts: starts that are already known, by onset in ns.

    Returns:
        Stamp (ns) from which the twin follows the run, and a message.
    """
    text = _stand(memory, driver, parameters, starts.get(driver.onset_ns))
    m: Any = memory.record[0]
    start, gait = max(driver.onset_ns, int(m["processed_ns"])), driver.gait
    late = (start - driver.onset_ns) / NANOSECONDS
    m["command"], m["cycle"], m["cycle_end_ns"] = 0.0, 0, 0
    m["has_gait"] = gait is not None
    m["run"], m["start_ns"], m["end_ns"] = driver.run, driver.onset_ns, 0
    if gait is not None:
        for name in WAVEFORM:
            m[name] = getattr(gait, name)
        m["command"] = gait.command(0.0)
        m["cycle"] = math.floor(late * gait.frequency + 1e-9) + 1
        m["cycle_end_ns"] = end_of_cycle(m, gait)
        if late > 0.0:
            m["command"], m["answer"] = _joined(gait, late, parameters)
    if late > LATE_S:
        text += f"; its onset was {late:.2f} s ago, so the twin joins at the present phase of the command"
        m["origin_known"] = m["origin_known"] and m["cycle"] <= 1
    if late > 0.0:
        m["start_known"] = m["start_known"] and m["origin_known"]
    m["engaged"], m["command_ns"], m["cycle_groove"] = 1, start, 0
    m["moved"], m["blind_s"], m["warning"], m["warned_until"] = 0, 0.0, 0, 0
    m["instrument_ns"], m["instrument_power"], m["instrument_energy"] = start, math.nan, 0.0
    memory.sums[:] = 0.0
    m["edge_slack"] = 0.0
    # At the onset the twin resets its position to the tracker's, so earlier position residuals no longer count.
    m["channel_ns"][POSITION] = m["channel_level"][POSITION] = 0
    return start, text


def _stand(
    memory: Memory,
    driver: DriverState,
    parameters: Parameters,
    start: Start | None,
) -> str:
    """Set L0, pose and origin of a run at its onset, from the samples at rest before it; return a message."""
    m: Any = memory.record[0]
    rest = _at_rest(memory, driver.onset_ns)
    pulled = 0.0 if driver.gait is None else resting_change(driver.gait, parameters)
    length, position = rest.length - pulled, rest.position
    direction = FORWARD if driver.gait is None else driver.gait.direction
    before = parameters.replace(initial_length=float(m["initial_length"]))
    tightened = pulled or _tightened(m, before, rest)
    if tightened != pulled or not rest.settled:
        length = math.nan  # a length that is still changing is not L0
    if abs(length - parameters.initial_length) <= PLAUSIBLE_M:  # False for NaN
        initial_length, source = length, "as measured at rest"
        tracked, fitted = True, False
    elif m["length_seen"] or m["length_fitted"]:
        initial_length, source = before.initial_length, "as in the previous run"
        tracked, fitted = bool(m["length_seen"]), bool(m["length_fitted"])
    else:
        initial_length, source = parameters.initial_length, "from the parameters"
        tracked, fitted = False, False
    text = f"a run begins, L0 = {1e3 * initial_length:.2f} mm ({source})"
    if pulled:
        text += f"; the pretension makes the body {-1e3 * pulled:.1f} mm shorter"
    elif tightened:
        text += (
            f"; the slack is still taken up, which makes the body {-1e3 * tightened:.1f} mm shorter"
        )
    standing = initial_length + tightened
    turned = _lengths_when_turned(m, initial_length, before.gain * before.slack)
    lengths = turned if pulled or not tightened else (standing,)
    places = [_left_behind(m, before, standing, direction, at) for at in lengths]
    place = places[0]
    known = place is not None and place == places[-1]
    if place is not None and math.isfinite(position):
        place = min(filter(None, places), key=lambda each: each.off(position, parameters.pitch))
        off = place.off(position, parameters.pitch)
        known = off <= SURE_M
        if off <= TOLERANCE * parameters.pitch:
            place = _Place(place.x1, place.front_groove, position - place.x1)
        else:
            place = None
            text += "; the robot was moved since the previous run"
    if place is None:
        anchor = float(m["origin"]) if math.isnan(position) else position
        free = _unstressed(parameters.replace(initial_length=initial_length), direction, pulled)
        stands, known = start or free, start is not None
        place = _Place(stands.x1, stands.front_groove, anchor - stands.x1)
    m["direction"], m["answer"], m["initial_length"] = direction, tightened, initial_length
    m["length_seen"], m["length_fitted"] = tracked, fitted
    m["pose_x1"], m["pose_front"], m["origin"] = place.x1, place.front_groove, place.anchor
    m["origin_known"] = bool(m["origin_known"]) or math.isfinite(position)
    m["start_known"] = known
    return text


def _unstressed(parameters: Parameters, direction: int, pulled: float) -> Start:
    """Return the pose of a robot whose fins only the load and the pretension deflect; ``pulled`` is ΔL (m)."""
    model = Locomotion(parameters, direction)
    try:
        motion = model.at_rest(length_change=pulled)
    except SimulationError:
        return Start(0.0, front_groove(parameters))
    x1 = model.x1(motion) - motion.rear_groove * parameters.pitch
    return Start(x1, motion.front_groove - motion.rear_groove)


def _lengths_when_turned(m: Any, released: float, shorter: float) -> tuple[float, ...]:
    """Return the possible lengths (m) of the body when the fins were turned for a run, the preferred one first.

    The driver turns the fins when the rest before the run begins, or, if the cable has to return first, when it has
    returned.

    Args:
        m: record of the memory, at the onset.
        released: length of the body with a slack cable, m.
        shorter: effect of the slack, which may still have been taken up when the fins were turned, m.
    """
    pulled_until = max(int(m["end_ns"]), int(m["released_ns"]))
    since = max(int(m["rest_ns"]) - pulled_until, 0)
    if m["rest_ns"] < m["end_ns"]:  # It is not known when the driver began to rest.
        return (released, released - shorter)
    if since <= TAUT_NS:
        return (released - shorter,)
    return (released,) if since >= SLACK_NS else (released, released - shorter)


def _tightened(m: Any, before: Parameters, rest: _Rest) -> float:
    """Return ΔL (m) of a body at rest if its slack is still taken up, or is returning, after a run; otherwise 0."""
    shorter = before.gain * before.slack
    change = rest.length - before.initial_length
    if m["start_ns"] and abs(change + shorter) < min(TIGHTENED * shorter, PLAUSIBLE_M):
        return change
    coming_back = m["start_ns"] and not rest.settled and -shorter < change < 0.0
    return change if coming_back else 0.0


class _Place(NamedTuple):
    """Place of a robot at rest.

    Attributes:
        x1: position of the rear module relative to its anchor, m.
        front_groove: front anchor in grooves from the rear one.
        anchor: position of the rear anchor in the tracker's frame, m.
    """

    x1: float
    front_groove: int
    anchor: float

    def off(self, position: float, pitch: float) -> float:
        """Return the distance (m) between a rear module at ``position`` (m) and this place, modulo the ``pitch``."""
        off = position - (self.anchor + self.x1)
        return abs(off - round(off / pitch) * pitch)


class _Rest(NamedTuple):
    """Measurements of the robot at rest before an onset.

    Attributes:
        length: measured body length, or else x2 − x1 of the tracker, m.
        settled: True if the length no longer changes.
        position: position of the rear module, m.
    """

    length: float
    settled: bool
    position: float


def _at_rest(memory: Memory, onset_ns: int) -> _Rest:
    """Return the measurements of the robot at rest before an onset; NaN where there are too few samples."""
    m = memory.record[0]
    if m["start_ns"] and not m["end_ns"]:
        return _Rest(math.nan, settled=False, position=math.nan)  # another gait has run until now
    rows = memory.rows[: int(m["place"])]
    last = onset_ns - GUARD_NS
    first = max(last - round(REST_S * NANOSECONDS), int(m["end_ns"]))
    rows = rows[(rows["stamp"] >= first) & (rows["stamp"] <= last)]
    lengths = rows["a"][rows["kind"] == SampleKind.LENGTH]
    tracker = rows[rows["kind"] == SampleKind.POSITION]
    if np.count_nonzero(np.isfinite(lengths)) < FEWEST:
        lengths = tracker["b"] - tracker["a"]
    length, settled = _settled(lengths)
    return _Rest(length, settled, _settled(tracker["a"])[0])


def _settled(values: np.ndarray) -> tuple[float, bool]:
    """Return the mean of the last values without motion, and True if the motion has ended.

    The mean is NaN for fewer than `FEWEST` values. Values before a motion are excluded, because a body whose slack
    returns moves by millimetres.
    """
    values = values[np.isfinite(values)]
    if len(values) < FEWEST:
        return math.nan, False
    tolerance = STILL_M + STILL_NOISE * float(np.median(np.abs(np.diff(values))))
    moved = np.flatnonzero(np.abs(values - np.mean(values[-FEWEST:])) > tolerance)
    still = values[moved[-1] + 1 :] if moved.size else values
    if len(still) < 2 * FEWEST:
        return float(np.mean(values[-FEWEST:])), not moved.size
    half = len(still) // 2
    drift = abs(np.mean(still[-half:]) - np.mean(still[:half]))
    return float(np.mean(still)), bool(drift < tolerance / math.sqrt(half))


def _joined(gait: Gait, elapsed: float, parameters: Parameters) -> tuple[float, float]:
    """Return u_cmd and ΔL (m) at a time (s) after the onset of a gait whose commands the twin did not receive."""
    # The previous and the present cycle suffice, because the effect of earlier commands has decayed.
    start = max(0, int(elapsed * gait.frequency) - 1) * gait.period
    times = np.append(np.arange(start, elapsed, JOIN_STEP_S), elapsed)
    commands = gait.command(times)
    return float(commands[-1]), float(length_change_of_command(times, commands, parameters)[-1])


def _left_behind(
    m: Any, parameters: Parameters, length: float, direction: int, turned_at: float
) -> _Place | None:
    """Return the place where the previous run leaves the robot, or None if the place is unknown.

    Args:
        m: record of the memory.
        parameters: parameters of the previous run.
        length: length of the body at rest, m.
        direction: direction of the next run.
        turned_at: length of the body when the fins were turned, m.
    """
    if not m["moving"] or not m["start_ns"]:
        return None
    before = int(m["direction"])
    model = Locomotion(parameters, before)
    standing = length if direction == before else turned_at
    try:
        motion = model.settled(motion_of(m), standing - parameters.initial_length)
        grooves = int(m["moved"]) + motion.rear_groove
        x1 = model.x1(motion) - motion.rear_groove * parameters.pitch
        front = motion.front_groove - motion.rear_groove
        if direction != before:
            model = Locomotion(parameters, direction)
            over = round(x1 / parameters.pitch)
            front = round((x1 + standing) / parameters.pitch) - over
            grooves, x1 = grooves + over, x1 - over * parameters.pitch
            change = standing - parameters.initial_length
            turned = model.start(0.0, change, x1, front)
            x1 = model.x1(model.settled(turned, length - parameters.initial_length))
    except SimulationError:
        return None
    return _Place(x1, front, float(m["origin"]) + grooves * parameters.pitch)


def motion_of(m: Any) -> LocomotionState:
    """Return the motion of the memory's record ``m`` as a state at time 0."""
    regions = int(m["rear_region"]), int(m["front_region"])
    grooves = int(m["rear_groove"]), int(m["front_groove"])
    return LocomotionState(
        0.0, float(m["length_change"]), float(m["y"]), float(m["y_rate"]), *grooves, *regions
    )
