# SPDX-License-Identifier: Apache-2.0
"""Diagnosis at the end of each cycle, from the sums that the core collects.

`worm_model.twin.causes` weighs the causes. This module decides which of them are reported, and how the twin adapts. If
a tracker saw the end of the cycle, it determines by how many grooves the robot is off; timing and power determine the
fin. A report is due when a healthy robot has at most the probability ``SOUND_AT_MOST``. It names the cause if one has
at least the probability ``SURE``. If none has after another cycle, it lists the causes that remain possible.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from worm_model.arrays import Array
from worm_model.gait import Gait
from worm_model.parameters import Parameters
from worm_model.twin.causes import (
    CABLE,
    FRICTION_DOWN,
    FRICTION_UP,
    GAIN,
    GAINED,
    GROOVES,
    LENGTH,
    MISS,
    MISSED_FRONT,
    MISSED_REAR,
    ODD,
    OFFSET,
    SCALE,
    Candidate,
    Told,
    weigh_causes,
)
from worm_model.twin.core.memory import LENGTH_COUNT, POSITION, POSITION_COUNT, POSITION_SUM
from worm_model.twin.cycle_data import STEP_M, WINDOW, CycleData, Step, cycle_data
from worm_model.twin.signatures import (
    BINS,
    FAULTS,
    OFFSET_W,
    SLIP_M,
    Signatures,
    signatures,
)
from worm_model.twin.signatures import SCALE as USUAL_SCALE

MISSED, AMBIGUOUS, GAP = "missed_groove", "ambiguous", "gap"
CAMERA, ROBOT, NOTHING = "camera_moved", "robot_moved", ""

REMEMBERED = 6  # cycles
SOUND_AT_MOST, SURE = 0.05, 0.9  # probabilities
MOVED = 0.002  # probability per cycle that a person moves the robot, or the camera
MOST_GROOVES = 8  # largest number of grooves by which a person moves the robot
LASTED = 0.5  # smallest part of a cycle after which a change counts as lasting
WHOLE_M = 0.0008  # standard deviation of a step by whole grooves
CAMERA_M = 0.03  # usual step of the positions when a camera is moved
LENGTHS = 2  # smallest number of cycles from which L0 is estimated
TIMING = 0.06  # standard deviation of the phase at which a fin slips
ANY_TIME = 0.05  # share of missed grooves at an arbitrary phase
MORE = 0.02  # probability that a fin misses the next groove of the same cycle, too
SWIFT = {"camera": 0.97, "robot": 0.2, "fin": 0.05}  # probability that a step takes no time
SLIGHT_M = 0.005  # smaller steps are reported only if they last for another cycle


@dataclass(frozen=True)
class CycleSeen:
    """Cycle that has ended.

    Attributes:
        number: number of the cycle, from 1.
        sums: sums of its residuals, shape (PHASES, SUMS).
        gait: gait of the run.
        parameters: parameters with the L0 of the run.
        noise: noise of a sample in the channel's unit, shape (CHANNELS,).
        length_seen: True if an instrument measured L0.
        blind_s: time without any data about the length, s.
        joined: True if the twin joined the run in this cycle.
    """

    number: int
    sums: NDArray[np.float64]
    gait: Gait
    parameters: Parameters
    noise: NDArray[np.float64]
    length_seen: bool = False
    blind_s: float = 0.0
    joined: bool = False


@dataclass(frozen=True)
class Finding:
    """Result of the diagnosis, and how the twin adapts to it.

    Attributes:
        code: code of TwinEvent, empty for plain information.
        text: message for the operator.
        cycle: cycle to which it refers.
        probability: probability of the cause, NaN if not computed.
        grooves: grooves along +x by which the robot is further than predicted.
        shift: shift of the tracker's zero, m.
        initial_length: new L0, m; NaN if it stays.
        explains_position: True if it explains the position residuals so far.
    """

    code: str
    text: str
    cycle: int
    probability: float = math.nan
    grooves: int = 0
    shift: float = 0.0
    initial_length: float = math.nan
    explains_position: bool = False


@dataclass(frozen=True)
class History:
    """Remembered part of a run.

    Attributes:
        cycles: last cycles.
        told: causes already reported.
        unplaced: True if the robot's position is unknown, because the twin was late or L0 was wrong.
        blind_s: time without data about the robot, s; 0 once a tracker has seen the end of a cycle.
        slight: True if the last cycle had a small step that may be none.
        doubt: True if several causes remained possible.
        doubted: True if that was reported.
        missed: grooves missed, by the tracker.
        extra: grooves gained, by the tracker.
        missed_by_power: grooves missed, by power alone.
    """

    cycles: tuple[CycleData, ...] = ()
    told: tuple[Told, ...] = ()
    unplaced: bool = False
    blind_s: float = 0.0
    slight: bool = False
    doubt: bool = False
    doubted: bool = False
    missed: int = 0
    extra: int = 0
    missed_by_power: int = 0


def judge_cycle(history: History, cycle: CycleSeen) -> tuple[History, list[Finding]]:
    """Return the updated history and the findings at the end of a cycle."""
    driven = bool(np.mean(cycle.sums[:, LENGTH_COUNT] > 0) > 0.25)
    # L0 as measured differs from run to run by less than matters here.
    length = round(cycle.parameters.initial_length, 4)
    signs = signatures(cycle.gait, cycle.parameters.replace(initial_length=length), driven=driven)
    data = cycle_data(
        cycle.number,
        cycle.sums,
        cycle.noise,
        signs.power,
        cycle.parameters.pitch,
        fresh=not history.cycles,
    )
    history = replace(
        history,
        unplaced=history.unplaced or cycle.joined,
        blind_s=history.blind_s + cycle.blind_s,
    )
    history, data, findings = _place(history, cycle, data)
    if cycle.joined or cycle.blind_s:  # the course of this cycle is unknown
        return replace(history, cycles=()), findings
    step = data.step
    if step is not None and not step.is_none:
        data = replace(data, gained=_whole(step.size, cycle) * cycle.gait.direction)
    history = replace(history, cycles=(*history.cycles, data)[-REMEMBERED:])
    weighed = _weigh(history, cycle, signs)
    history, finding = _length(history, cycle, weighed)
    if finding is not None:
        return history, [*findings, finding]
    if step is None or step.is_none:
        history = replace(history, slight=False)
    else:
        history, finding = _settle(history, cycle, step, weighed, signs)
        findings += [finding] if finding is not None else []
        weighed = _weigh(history, cycle, signs)
    history, others = judge_causes(history, cycle.number, weighed)
    return history, findings + others


def explains(history: History, cycle: CycleSeen) -> bool:
    """Return True if the twin's motion explains the positions of a cycle that `judge_cycle` has added to a history."""
    step = history.cycles[-1].step if history.cycles else None
    if step is not None and not step.is_none:
        return False
    seen = cycle.sums[:, POSITION_COUNT] > 0
    if not seen.any():
        return True
    means = cycle.sums[seen, POSITION_SUM] / cycle.sums[seen, POSITION_COUNT]
    return bool(np.sqrt(np.mean(means**2)) <= STEP_M)


def off_at_end(cycle: CycleSeen) -> float:
    """Return the mean position residual (m) over the last part of a cycle; NaN without tracker samples."""
    last = cycle.sums[-round(WINDOW * len(cycle.sums)) :]
    count = last[:, POSITION_COUNT].sum()
    return float(last[:, POSITION_SUM].sum() / count) if count else math.nan


def _weigh(history: History, cycle: CycleSeen, signs: Signatures) -> list[Candidate]:
    return weigh_causes(history.cycles, history.told, signs, length_seen=cycle.length_seen)


# --- position of the robot after the twin was late or had no data for a time --------------------------


def _place(
    history: History, cycle: CycleSeen, data: CycleData
) -> tuple[History, CycleData, list[Finding]]:
    """Reset the robot's position to the tracker's after a time without data about it."""
    if data.step is None or not (history.unplaced or history.blind_s):
        return history, data, []
    size, variance = data.step.size, data.variance.copy()
    variance[POSITION] = np.inf
    data = replace(data, step=Step(0.0), variance=variance)
    # A cycle that the twin came to in the middle does not end where whole ones do.
    unknown = replace(history, unplaced=cycle.joined, blind_s=0.0)
    if history.unplaced:
        if not cycle.joined and abs(size) <= STEP_M:
            return unknown, data, []
        text = f"cycle {cycle.number}: the twin takes the tracker's word for where the robot stands"
        return unknown, data, [Finding("", text, cycle.number, shift=size, explains_position=True)]
    grooves = _whole(size, cycle)
    if not grooves:
        return unknown, data, []
    where = "further" if grooves * cycle.gait.direction > 0 else "less far"
    text = (
        f"cycle {cycle.number}: unknown for {history.blind_s:.1f} s, after which the robot is {_count(grooves)} "
        f"{where} than predicted ({_off(size)}); the twin's anchors were moved there"
    )
    return unknown, data, [_moved(GAP, text, cycle.number, math.nan, grooves)]


def _whole(size: float, cycle: CycleSeen) -> int:
    """Return a step (m) along +x in grooves, 0 if it is not a whole number."""
    grooves = round(size / cycle.parameters.pitch)
    return grooves if abs(size - grooves * cycle.parameters.pitch) <= 4.0 * WHOLE_M else 0


# --- a step that the tracker saw ------------------------------------------------------------------------


def _settle(
    history: History,
    cycle: CycleSeen,
    step: Step,
    weighed: Sequence[Candidate],
    signs: Signatures,
) -> tuple[History, Finding | None]:
    """Attribute a step of the position to a fin, a person who moved the robot, or the camera."""
    shares = _shares_of_step(cycle, step, weighed, signs)
    best = max(shares, key=lambda code: shares[code])
    if best == NOTHING:
        return replace(history, slight=False), None
    if best == CAMERA and abs(step.size) < SLIGHT_M and not history.slight:
        return replace(history, slight=True), None
    history = replace(history, slight=False)
    number, grooves = cycle.number, _whole(step.size, cycle)
    gained = grooves * cycle.gait.direction
    fins = shares[MISSED_REAR] + shares[MISSED_FRONT] + shares[MISSED]
    name = "gained" if gained > 0 else "missed"
    off = (
        f"({_off(step.size)} since {step.phase * cycle.gait.period:.1f} s after the cycle's begin)"
    )
    follows = "; the twin's anchors were moved there"
    if shares[GAINED] >= SURE or fins >= SURE:
        by = {MISSED_REAR: " with the rear fin", MISSED_FRONT: " with the front fin"}
        best = best if shares[best] >= SURE else MISSED
        text = f"cycle {number}: the robot {name} {_count(gained)}{by.get(best, '')} {off}{follows}"
        history = replace(
            history,
            told=(*history.told, Told(name, number))[-REMEMBERED:],
            missed=history.missed + max(-gained, 0),
            extra=history.extra + max(gained, 0),
        )
        return history, _moved(best, text, number, shares.get(best, fins), grooves)
    history = replace(history, told=(*history.told, Told("", number))[-REMEMBERED:])
    probability = shares[best]
    if probability < SURE:
        named = {
            ROBOT: "a robot that was moved",
            CAMERA: "a camera that was moved",
            GAINED: f"{_count(gained)} gained",
        }
        likely = {code: share for code, share in shares.items() if code in named and share > 0.05}
        if fins > 0.05:
            likely[MISSED], named[MISSED] = fins, f"{_count(gained)} missed"
        text = f"cycle {number}: cannot tell between {_listed(likely, named)} {off}"
        best, probability = AMBIGUOUS, max(likely.values())
    elif best == ROBOT:
        way = "along" if gained > 0 else "against"
        text = f"cycle {number}: the robot was moved by {_count(gained)} {way} its gait {off}"
    else:
        text = (
            f"cycle {number}: the camera was moved: its positions are {1e3 * step.size:+.1f} mm off, no whole "
            "grooves; the twin's zero follows"
        )
    if grooves and best != CAMERA:
        return history, _moved(best, text + follows, number, probability, grooves)
    return history, Finding(
        best, text, number, probability, shift=step.size, explains_position=True
    )


def _shares_of_step(
    cycle: CycleSeen, step: Step, weighed: Sequence[Candidate], signs: Signatures
) -> dict[str, float]:
    """Return the probability of each code that can explain a step."""
    pitch, grooves = cycle.parameters.pitch, _whole(step.size, cycle)
    gained = grooves * cycle.gait.direction
    shares = dict.fromkeys((MISSED_REAR, MISSED_FRONT, MISSED, GAINED, ROBOT), 0.0)
    swift = {who: p if step.swift else 1.0 - p for who, p in SWIFT.items()}
    shares[CAMERA] = MOVED * _normal(step.size, CAMERA_M) * swift["camera"]
    shares[NOTHING] = _normal(step.size, WHOLE_M)
    if grooves:
        whole = _normal(step.size - grooves * pitch, WHOLE_M)
        shares[ROBOT] = MOVED / (2 * MOST_GROOVES) * whole * swift["robot"]
        missed = gained < 0
        chance = whole * swift["fin"] * 2.0 * (MISS * MORE ** (-gained - 1) if missed else GAIN)
        changes = signs.missed if missed else signs.gained
        if (missed and -gained <= max(signs.grooves, 1)) or gained == 1:
            shares[MISSED if missed else GAINED] = ANY_TIME * chance
            for fin, change in changes.items():
                code = GROOVES[fin] if missed else GAINED
                timely = _normal(step.phase - _lets_go(change[1, POSITION], pitch), TIMING)
                evidence = _evidence(weighed, code, fin, cycle.number)
                shares[code] += (1.0 - ANY_TIME) / len(changes) * chance * timely * evidence
    total = sum(shares.values())
    return {code: share / total for code, share in shares.items()}


def _lets_go(position: Array, pitch: float) -> float:
    """Return the phase at which the position residual of a missed groove reaches half a pitch."""
    return float(np.argmax(np.abs(position) > 0.5 * pitch)) / BINS


def _evidence(weighed: Sequence[Candidate], code: str, fin: str, number: int) -> float:
    """Return the Bayes factor of a fin's missed or gained groove in a cycle."""
    wanted = (code, fin, number, 1)
    matching = [c for c in weighed if (c.code, c.name, c.cycle, c.cycles) == wanted]
    return matching[0].weight / math.exp(matching[0].log_prior) if matching else 1.0


def _normal(value: float, spread: float) -> float:
    return math.exp(-0.5 * (value / spread) ** 2) / (spread * math.sqrt(2.0 * math.pi))


# --- L0 ---------------------------------------------------------------------------------------------------


def _length(
    history: History, cycle_seen: CycleSeen, weighed: Sequence[Candidate]
) -> tuple[History, Finding | None]:
    """Return a new L0 as a finding if all cycles since the beginning support it, and not missed grooves."""
    lengths = [c for c in weighed if c.code == LENGTH]
    share = sum(c.weight for c in lengths) / (1.0 + sum(c.weight for c in weighed))
    settled = sum(cycle.step is not None for cycle in history.cycles)
    if share < 1.0 - SOUND_AT_MOST or settled < LENGTHS:
        return history, None
    best = max(lengths, key=lambda c: c.weight)
    before = cycle_seen.parameters.initial_length
    text = (
        f"cycle {cycle_seen.number}: L0 is taken as {1e3 * (before + best.error):.1f} mm instead of "
        f"{1e3 * before:.1f} mm, "
        "as positions and power have it since the run began"
    )
    finding = Finding(LENGTH, text, cycle_seen.number, share, initial_length=before + best.error)
    anew = History(
        unplaced=True,
        missed=history.missed,
        extra=history.extra,
        missed_by_power=history.missed_by_power,
    )
    return anew, replace(finding, explains_position=True)


# --- what else ------------------------------------------------------------------------------------------


def judge_causes(
    history: History, number: int, weighed: Sequence[Candidate]
) -> tuple[History, list[Finding]]:
    """Return the updated history and the findings that a healthy robot does not explain, except the tracker's steps."""
    total = 1.0 + sum(c.weight for c in weighed)
    if 1.0 / total > SOUND_AT_MOST:
        return replace(history, doubt=False), []
    findings = []
    for cycle in history.cycles:
        if cycle.watched:
            continue  # the tracker determines these grooves
        covering = [c for c in weighed if c.cycle <= cycle.number < c.cycle + c.cycles]
        shares = {
            code: _share((c for c in covering if c.code == code), total)
            for code in (MISSED_REAR, MISSED_FRONT, GAINED)
        }
        missed = shares[MISSED_REAR] + shares[MISSED_FRONT]
        best = max(shares, key=lambda code: shares[code])
        if max(missed, shares[GAINED]) >= SURE:
            best, share = (best, shares[best]) if shares[best] >= SURE else (MISSED, missed)
            findings.append(
                Finding(best, _by_power(best, cycle.number, share), cycle.number, share)
            )
    reported = [Told("gained" if f.code == GAINED else "missed", f.cycle) for f in findings]
    lasting = _by_code([c for c in weighed if not c.cycles and c.code != LENGTH])
    for group in lasting.values():
        share, best_one = _share(group, total), max(group, key=lambda c: c.weight)
        lasted = best_one.cycle < number or best_one.phase < LASTED
        if share >= SURE and lasted:
            if not _known(history.told, best_one, {c.name for c in group}):
                findings.append(_lasts(best_one, _code(best_one), share))
            reported += [Told(c, best_one.cycle, best_one.phase) for c in {c.name for c in group}]
    if reported:
        missed = sum(f.code in (MISSED, MISSED_REAR, MISSED_FRONT) for f in findings)
        history = replace(
            history,
            told=(*history.told, *reported)[-REMEMBERED:],
            missed_by_power=history.missed_by_power + missed,
            doubt=False,
            doubted=False,
        )
        return history, findings
    if not history.doubt or history.doubted:
        return replace(history, doubt=True), []
    return replace(history, doubted=True), _doubt(number, weighed, total)


def _known(reported: Iterable[Told], candidate: Candidate, names: set[str]) -> bool:
    """Return True if the cause was already reported; its beginning may be known more precisely now."""
    return any(t.name in names and abs(t.cycle - candidate.cycle) <= 1 for t in reported)


def _by_code(candidates: Iterable[Candidate]) -> Mapping[str, list[Candidate]]:
    groups = defaultdict(list)
    for candidate in candidates:
        groups[_code(candidate)].append(candidate)
    return groups


def _code(candidate: Candidate) -> str:
    """Return the code, which for friction depends on the sign of the size."""
    return FRICTION_DOWN if candidate.code == FRICTION_UP and candidate.size < 0 else candidate.code


def _share(candidates: Iterable[Candidate], total: float) -> float:
    return sum(c.weight for c in candidates) / total


def _lasts(candidate: Candidate, code: str, share: float) -> Finding:
    since = f"since cycle {candidate.cycle}: {_size(candidate)} (probability {100 * share:.0f} %)"
    return Finding(code, since, candidate.cycle, share)


def _size(candidate: Candidate) -> str:
    """Return the description of a lasting cause with its size and twice the deviation."""
    unit, scale, text = {
        "gain": ("%", 100.0 * FAULTS["gain"], "the gain of the body's answer changed by {}"),
        "slip": ("mm", 1e3 * SLIP_M, "the body is longer under the same command by {}"),
        "viscous_friction": ("%", 100.0 * FAULTS["viscous_friction"], "friction changed by {}"),
        "scale": ("%", 100.0 * USUAL_SCALE, "the scale of the power changed by {}"),
        "offset": ("W", OFFSET_W, "the power's zero changed by {}"),
    }[candidate.name]
    value = f"{scale * candidate.size:+.1f} ± {2.0 * scale * candidate.deviation:.1f} {unit}"
    return text.format(value) + CAUSES[candidate.code]


#: possible explanation by code
CAUSES = {
    CABLE: ": a cable that slips, is slack or stretched",
    FRICTION_UP: "",
    SCALE: ": supply or shunt",
    OFFSET: ": power sensor, or something else that draws from the supply",
}
NAMED = {
    MISSED_REAR: "a groove missed by the rear fin",
    MISSED_FRONT: "a groove missed by the front fin",
    GAINED: "a groove gained",
    CABLE: "a cable that slips, is slack or stretched",
    FRICTION_UP: "more friction",
    FRICTION_DOWN: "less friction",
    SCALE: "another scale of the power",
    OFFSET: "another zero of the power",
    LENGTH: "another L0",
    ODD: "something odd in one cycle alone",
}


def _by_power(code: str, number: int, share: float) -> str:
    what = {GAINED: "a groove gained", MISSED: "a missed groove"}.get(code, NAMED.get(code, ""))
    return f"cycle {number}: its power is that of {what} (probability {100 * share:.0f} %)"


def _doubt(number: int, weighed: Sequence[Candidate], total: float) -> list[Finding]:
    shares = {code: _share(group, total) for code, group in _by_code(weighed).items()}
    likely = {code: share for code, share in shares.items() if share > 0.05}
    if set(likely) == {ODD}:
        number = max((c for c in weighed if c.code == ODD), key=lambda c: c.weight).cycle
        text = f"cycle {number}: something was odd that no cause known to the twin explains"
    elif len(likely) > 1:
        text = f"cycle {number}: cannot tell between {_listed(likely, NAMED)}"
    else:
        return []
    return [Finding(AMBIGUOUS, text, number, max(likely.values()))]


def _listed(shares: Mapping[str, float], named: Mapping[str, str]) -> str:
    ordered = sorted(shares, key=lambda code: -shares[code])
    return " and ".join(f"{named[code]} ({100 * shares[code]:.0f} %)" for code in ordered)


def _count(gained: int) -> str:
    return "a groove" if abs(gained) == 1 else f"{abs(gained)} grooves"


def _off(size: float) -> str:
    return f"position {1e3 * size:+.1f} mm off"


def _moved(code: str, text: str, cycle: int, probability: float, grooves: int) -> Finding:
    return Finding(code, text, cycle, probability, grooves=grooves, explains_position=True)
