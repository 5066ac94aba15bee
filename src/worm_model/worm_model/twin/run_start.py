# SPDX-License-Identifier: Apache-2.0
"""When a run begins, and from what: rest pose, initial length, and how the run before left the fins.

At the onset all samples before it have been taken. x1 is where the tracker saw the rear module over the last
``rest_s``, L0 the mean measured length of that span (else that of the run before, else the parameter). The first run
starts with each module on its groove. After a run the fins stay where they are: the modules stand off their grooves
by up to some millimetres, which another start would get wrong for the whole next run. While the cable rests the
body takes its initial length again, and fins that are turned for the other direction find the nearest grooves. If it
is seen shorter by what the slack costs, the transmission's slack is still taken up: L0 stays, and ΔL starts there.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from worm_model.gait import FORWARD, Gait, GaitError
from worm_model.parameters import Parameters
from worm_model.run import is_another_run
from worm_model.simulation.actuation import length_change_of_command
from worm_model.simulation.closed_form import front_groove
from worm_model.simulation.simulator import Locomotion, LocomotionState, SimulationError
from worm_model.twin.core.memory import NANOSECONDS, Memory
from worm_model.twin.records import Activity
from worm_model.twin.samples import Kind
from worm_model.twin.twin_settings import TwinSettings

PLAYING = (Activity.RUNNING, Activity.STOPPING)
LATE_NS = 20_000_000  # an onset heard of later than this is worth a word
PLAUSIBLE_M = 0.02  # between a measured length at rest and the parameter's
TAKEN_UP = 0.35  # of what the slack costs, by which a body whose slack is taken up may be off
FEWEST = 5  # samples that make a mean
# before the onset, as its stamp and the instruments' come from different clocks
GUARD_NS = 100_000_000
RELAX_S = 1.0  # in which the body takes its initial length again, and as long to come to rest
TOLERANCE = 0.3  # of a pitch, that a robot which nobody touched may be off its place
JOIN_STEP_S = 0.01  # of the commands that a late twin did not hear


@dataclass(frozen=True)
class Word:
    """What the driver does from a stamp on.

    ``onset_ns``, ``run`` and ``cycle`` are 0 where unknown, ``gait`` is None without one.
    """

    stamp_ns: int
    activity: Activity
    gait: Gait | None = None
    onset_ns: int = 0
    run: int = 0
    cycle: int = 0


def word_of(row: Any) -> Word:
    """The driver's word in a sample of kind GAIT; a gait that is not admissible counts as none."""
    gait: Gait | None
    try:
        gait = Gait(float(row["a"]), float(row["b"]), int(row["c"]), float(row["d"]))
    except GaitError:
        gait = None
    activity = Activity(int(row["state"]))
    identity = int(row["onset"]), int(row["run"]), int(row["cycle"])
    return Word(int(row["heard"]), activity, gait, *identity)


def is_new_run(m: Any, word: Word) -> bool:
    """Whether a word is the first of a run."""
    if word.activity not in PLAYING or word.onset_ns <= 0:
        return False
    if not m["start_ns"] or not m["has_gait"]:
        return True
    before = int(m["run"]), int(m["told_cycle"]), int(m["start_ns"])
    return bool(is_another_run(before, (word.run, word.cycle, word.onset_ns)))


@dataclass(frozen=True)
class Place:
    """The robot at rest: x1 in m from its rear anchor, the front anchor in grooves from that, and where that is (m)."""

    x1: float
    front_groove: int
    anchor: float

    def agrees_with(self, position: float, pitch: float) -> bool:
        """Whether a robot seen at a position (m) stands like this, in whichever groove."""
        off = position - (self.anchor + self.x1)
        return abs(off - round(off / pitch) * pitch) <= TOLERANCE * pitch


def begin_run(
    memory: Memory, word: Word, parameters: Parameters, settings: TwinSettings
) -> tuple[int, str]:
    """Sets a run's start in the memory; returns (the stamp from which it is followed, what to tell).

    An onset that the twin has passed already is heard of late, or the twin came late: it starts where it is, with
    the length that the gait would have by then.
    """
    m = memory.record[0]
    text, taken_up = _stand(memory, word, parameters, settings)
    start = max(word.onset_ns, int(m["taken_ns"]))
    late = start - word.onset_ns
    m["run"], m["start_ns"], m["end_ns"] = word.run, word.onset_ns, 0
    m["has_gait"] = word.gait is not None
    if word.gait is not None:
        m["stroke"], m["frequency"] = word.gait.stroke, word.gait.frequency
    m["engaged"], m["command_ns"], m["command"], m["answer"] = 1, start, 0.0, taken_up
    if late > 0 and word.gait is not None:
        m["command"], m["answer"] = _joined(word.gait, late / NANOSECONDS, parameters)
    m["moved"], m["blind_s"], m["warning"], m["warned_until"] = 0, 0.0, 0, 0
    m["instrument_ns"], m["instrument_power"], m["instrument_energy"] = start, math.nan, 0.0
    m["cycle"] = m["cycle_end_ns"] = 0
    memory.sums[:] = 0.0
    if word.gait is not None:
        m["cycle"] = math.floor(late / NANOSECONDS * word.gait.frequency + 1e-9) + 1
        m["cycle_end_ns"] = word.onset_ns + round(m["cycle"] * word.gait.period * NANOSECONDS)
    if late > LATE_NS:
        text += f"; its onset was {late / NANOSECONDS:.2f} s ago, the twin starts with its gait as commanded"
        m["origin_known"] = m["origin_known"] and not m["cycle"] > 1
    return start, text


def _stand(
    memory: Memory, word: Word, parameters: Parameters, settings: TwinSettings
) -> tuple[str, float]:
    """Sets L0, pose and origin from all that is known of the robot at rest before a run; (what to tell, ΔL in m)."""
    m = memory.record[0]
    length, position = _at_rest(memory, word.onset_ns, settings)
    direction = FORWARD if word.gait is None else word.gait.direction
    before = parameters.replace(initial_length=float(m["initial_length"]))
    taken_up = _taken_up(m, before, length)
    if taken_up:
        length = math.nan  # that is not L0
    if abs(length - parameters.initial_length) <= PLAUSIBLE_M:  # False for NaN
        initial_length, source = length, "as measured at rest"
        tracked, fitted = True, False
    elif m["length_seen"] or m["length_fitted"]:
        initial_length, source = before.initial_length, "as in the run before"
        tracked, fitted = bool(m["length_seen"]), bool(m["length_fitted"])
    else:
        initial_length, source = parameters.initial_length, "from the parameters"
        tracked, fitted = False, False
    text = f"a run begins, L0 = {1e3 * initial_length:.2f} mm ({source})"
    if taken_up:
        text += (
            f"; the slack is still taken up, which makes the body {-1e3 * taken_up:.1f} mm shorter"
        )
    place = _left_behind(m, before, initial_length + taken_up, direction)
    if place is not None and math.isfinite(position):
        if place.agrees_with(position, parameters.pitch):
            place = Place(place.x1, place.front_groove, position - place.x1)
        else:
            place = None
            text += "; the robot was moved since the last run"
    if place is None:
        anchor = float(m["origin"]) if math.isnan(position) else position
        place = Place(0.0, front_groove(parameters.replace(initial_length=initial_length)), anchor)
    m["initial_length"], m["length_seen"], m["length_fitted"] = initial_length, tracked, fitted
    m["direction"], m["origin"] = direction, place.anchor
    m["origin_known"] = m["origin_known"] or math.isfinite(position)
    m["pose_x1"], m["pose_front"] = place.x1, place.front_groove
    return text, taken_up


def _taken_up(m: Any, before: Parameters, length: float) -> float:
    """ΔL (m) of a body seen at rest at a length (m) after another run, if its slack is still taken up, else 0."""
    shorter = before.gain * before.slack
    change = length - before.initial_length
    if m["start_ns"] and abs(change + shorter) < min(TAKEN_UP * shorter, PLAUSIBLE_M):
        return change
    return 0.0


def _at_rest(memory: Memory, onset_ns: int, settings: TwinSettings) -> tuple[float, float]:
    """Mean measured length (without one the tracker's) and rear position before an onset, m; NaN if too few."""
    m = memory.record[0]
    if m["start_ns"] and not m["end_ns"]:
        return math.nan, math.nan  # another gait was played until now
    rows = memory.rows[: int(m["place"])]
    last = onset_ns - GUARD_NS
    first = max(last - round(settings.rest_s * NANOSECONDS), int(m["end_ns"]))
    rows = rows[(rows["stamp"] >= first) & (rows["stamp"] <= last)]
    lengths = rows["a"][rows["kind"] == Kind.LENGTH]
    tracker = rows[rows["kind"] == Kind.POSITION]
    length = _mean(lengths)
    return (_mean(tracker["b"] - tracker["a"]) if math.isnan(length) else length), _mean(
        tracker["a"]
    )


def _mean(values: np.ndarray) -> float:
    values = values[np.isfinite(values)]
    return float(np.mean(values)) if len(values) >= FEWEST else math.nan


def _joined(gait: Gait, elapsed: float, parameters: Parameters) -> tuple[float, float]:
    """(u_cmd, ΔL) in m after a time in s of a gait whose commands nobody heard, as if it had been played exactly."""
    # The lag forgets all but the last cycles.
    start = max(0, int(elapsed * gait.frequency) - 1) * gait.period
    times = np.append(np.arange(start, elapsed, JOIN_STEP_S), elapsed)
    commands = np.array([gait.command(time) for time in times.tolist()])
    return float(commands[-1]), float(length_change_of_command(times, commands, parameters)[-1])


def _left_behind(m: Any, parameters: Parameters, length: float, direction: int) -> Place | None:
    """Where the run before leaves the robot, at a length (m) at rest and with the fins set for a direction.

    None if there was no run. ``parameters`` are those of the run before.
    """
    if not m["moving"] or not m["start_ns"]:
        return None
    before = int(m["direction"])
    model = Locomotion(parameters, before)
    try:
        motion = _rested(model, motion_of(m), length)
        grooves = int(m["moved"]) + motion.rear_groove
        x1 = model.x1(motion) - motion.rear_groove * parameters.pitch
        front = motion.front_groove - motion.rear_groove
        if direction != before:
            model = Locomotion(parameters, direction)
            over, front = round(x1 / parameters.pitch), round((x1 + length) / parameters.pitch)
            grooves, x1, front = grooves + over, x1 - over * parameters.pitch, front - over
            change = length - parameters.initial_length
            x1 = model.x1(_rested(model, model.start(0.0, change, x1, front), length))
    except SimulationError:
        return None
    return Place(x1, front, float(m["origin"]) + grooves * parameters.pitch)


def motion_of(m: Any) -> LocomotionState:
    """The motion in the memory's record, at time 0."""
    regions = int(m["rear_region"]), int(m["front_region"])
    grooves = int(m["rear_groove"]), int(m["front_groove"])
    return LocomotionState(
        0.0, float(m["length_change"]), float(m["y"]), float(m["y_rate"]), *grooves, *regions
    )


def _rested(model: Locomotion, motion: LocomotionState, length: float) -> LocomotionState:
    """The motion once the body has taken a length (m) and has come to rest."""
    change = length - model.parameters.initial_length
    times = [motion.time + RELAX_S, motion.time + 2.0 * RELAX_S]
    return model.follow(motion, times, [change, change])[0]
