# SPDX-License-Identifier: Apache-2.0
"""Diagnosis at the end of each cycle, from the sums that the core collects.

`worm_model.twin.causes` weighs the causes. This module decides which of them are reported, and how the twin is
corrected.

- **A step of the position** (`worm_model.twin.cycle_data`) is visible if a tracker saw the end of the cycle. Its size
  determines by how many grooves the robot is off. Its timing and the power determine the fin. Unless scatter or a
  lasting cause explains the step, it is reported at once, if necessary as ambiguous. Only a small step of the camera
  has to last for another cycle.
- **Other causes** are reported when the probability of a healthy robot is at most ``HEALTHY_AT_MOST``. The report names
  each cause with at least the probability ``SURE``. If there is none, the twin waits for another cycle. If there is
  still none, the report lists the causes that remain possible.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from worm_model.arrays import Array
from worm_model.gait import Gait
from worm_model.parameters import Parameters
from worm_model.twin import causes
from worm_model.twin.cause_table import (
    AMBIGUOUS,
    CAMERA_MOVED,
    GAINED,
    GAP,
    INITIAL_LENGTH,
    LASTING,
    MISSED,
    MISSED_BY_FIN,
    MISSED_FRONT,
    MISSED_REAR,
    ROBOT_MOVED,
    EventCode,
)
from worm_model.twin.core.memory import (
    LENGTH_COUNT,
    LENGTH_SUM,
    POSITION,
    POSITION_COUNT,
    POSITION_SUM,
)
from worm_model.twin.cycle_data import (
    STEP_M,
    WINDOW,
    CycleData,
    Step,
    cycle_data,
    without_step,
)
from worm_model.twin.edges import Edge, edge_of, edge_of_body, with_rounded_length
from worm_model.twin.signatures import BINS, Signatures, signatures

#: code of plain information
INFORMATION = EventCode("", "", "", "")
NO_STEP = EventCode("", "no step at all", "", "")

REMEMBERED = 6  # cycles
HEALTHY_AT_MOST, SURE = 0.05, 0.9  # probabilities
MOVED = 0.002  # probability per cycle that a person moves the robot, or the camera
MOST_GROOVES = 8  # largest number of grooves by which a person moves the robot
LASTED = 0.5  # a change that begins after this phase of the last cycle is not yet reported
WHOLE_M = 0.0008  # standard deviation of the measured size of a step by whole grooves
LENGTHS = 2  # smallest number of cycles with a tracker from which L0 is estimated
TIMING = 0.06  # standard deviation of the phase at which a fin slips
ANY_TIME = 0.05  # probability that a fin's step begins at an arbitrary phase of the cycle
MORE = 0.02  # probability that a fin misses the next groove of the same cycle, too
# Probability that a step is instantaneous, by what has moved.
SWIFT = {"camera": 0.97, "robot": 0.2, "fin": 0.05}
LIKELY = 0.05  # smallest probability of a cause that a message lists
SLIGHT_M = 0.005  # a smaller step of the camera is reported only if it lasts for another cycle

# Names of causes in the history; a step without a name is not attributed to a fin.
_NAMES = {MISSED: "missed", MISSED_REAR: "missed", MISSED_FRONT: "missed", GAINED: "gained"}
_FINS = {MISSED_REAR: " with the rear fin", MISSED_FRONT: " with the front fin"}


@dataclass(frozen=True)
class CycleSeen:
    """Cycle that has ended.

    Attributes:
        number: number of the cycle, from 1.
        sums: sums of the cycle's residuals, shape (PHASES, SUMS).
        gait: gait of the run.
        parameters: parameters with the L0 of the run.
        noise: standard deviation of the noise of a sample, in the channel's unit, shape (CHANNELS,).
        length_seen: True if an instrument measured L0.
        blind_s: part of the cycle without data about the length, s.
        joined: True if the twin joined the run in this cycle.
        predicted: grooves that the twin gained in the cycle, along the gait's direction.
    """

    number: int
    sums: NDArray[np.float64]
    gait: Gait
    parameters: Parameters
    noise: NDArray[np.float64]
    length_seen: bool = False
    blind_s: float = 0.0
    joined: bool = False
    predicted: int = 0

    @cached_property
    def edges(self) -> tuple[Edge, Edge]:
        """Edges near the commanded stroke, and near the stroke that the body performed."""
        count = self.sums[:, LENGTH_COUNT]
        residuals = np.full_like(count, np.nan)
        np.divide(self.sums[:, LENGTH_SUM], count, out=residuals, where=count > 0)
        commanded = edge_of(self.gait, self.parameters)
        return commanded, edge_of_body(self.gait, self.parameters, residuals)


@dataclass(frozen=True)
class History:
    """Remembered part of a run.

    Attributes:
        cycles: data of the last cycles, at most REMEMBERED.
        reported: causes already reported; later cycles account for them.
        unplaced: True if the robot's position is unknown, because the twin was late or L0 was wrong.
        blind_s: time without data about the length, s; 0 once a tracker has seen the end of a cycle.
        slight: True if the last cycle had a small step of the camera that was not reported.
        doubt: True if the robot was probably not healthy in the last cycle, but no cause was certain.
        doubted: True if this doubt was reported.
    """

    cycles: tuple[CycleData, ...] = ()
    reported: tuple[causes.ReportedCause, ...] = ()
    unplaced: bool = False
    blind_s: float = 0.0
    slight: bool = False
    doubt: bool = False
    doubted: bool = False


@dataclass(frozen=True)
class Finding:
    """Result of the diagnosis, and how the twin adapts to it.

    Attributes:
        cycle: number of the cycle to which the result refers.
        description: message for the operator, without the cycle.
        code: code of the event.
        probability: probability of the cause, NaN if not computed.
        grooves: grooves along +x by which the twin moves its anchors.
        shift: shift of the twin's origin in the tracker's frame, m.
        initial_length: new L0, m; NaN if L0 stays.
        explains_position: True if the result explains the earlier position residuals, which then no longer count.
        silent: True if the twin adapts without an event.
    """

    cycle: int
    description: str
    code: EventCode = INFORMATION
    probability: float = math.nan
    grooves: int = 0
    shift: float = 0.0
    initial_length: float = math.nan
    explains_position: bool = False
    silent: bool = False

    @property
    def text(self) -> str:
        """Message for the operator."""
        return f"cycle {self.cycle}: {self.description}"


def judge_cycle(history: History, cycle: CycleSeen) -> tuple[History, list[Finding]]:
    """Return the updated history and the findings at the end of a cycle."""
    driven = bool(np.mean(cycle.sums[:, LENGTH_COUNT] > 0) > 0.25)
    signs = signatures(cycle.gait, with_rounded_length(cycle.parameters), driven=driven)
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
    if _lasts(history, cycle, data, signs):
        data = replace(data, step=Step(0.0))
    data = without_step(data)
    step = data.step
    fewer, more = (
        max(edge.chance(cycle.predicted, cycle.predicted + one) for edge in cycle.edges)
        for one in (-1, 1)
    )
    error = causes.model_error(data, signs)
    data = replace(data, predicted=cycle.predicted, error=error, fewer=fewer, more=more)
    if not history.cycles:
        data, misfits = _first(data)
        findings += misfits
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
        shares = _shares_of_step(cycle, data, step, weighed, signs)
        history, finding = _settle(history, cycle, step, shares)
        findings += [finding] if finding is not None else []
        weighed = _weigh(history, cycle, signs)
    history, others = judge_causes(history, cycle.number, weighed)
    return history, findings + others


def _first(data: CycleData) -> tuple[CycleData, list[Finding]]:
    """Return the first remembered cycle, and a finding if the parameters do not describe the robot.

    The transient of such a robot differs, too, so that the causes are weighed without this cycle.
    """
    if not data.is_misfit:
        return data, []
    text = (
        f"the parameters do not describe this robot: its residuals are up to {max(data.error):.0f} times the usual "
        "ones, and no single cause explains them; the twin reports only changes after this cycle"
    )
    unknown = replace(data, variance=np.full_like(data.variance, np.inf))
    return unknown, [Finding(data.number, text)]


def explains(history: History, cycle: CycleSeen) -> bool:
    """Return True if the twin's motion explains the positions of a cycle. The history must contain this cycle."""
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


def _lasts(history: History, cycle: CycleSeen, data: CycleData, signs: Signatures) -> bool:
    """Return True if a step that is not of whole grooves probably does not come from the camera.

    Instead, it comes from a lasting cause, such as a load that deflects the fins, or from the scatter of a healthy
    robot.
    """
    step = data.step
    if step is None or step.is_none or _whole(step.size, cycle):
        return False
    moved = causes.Candidate(CAMERA_MOVED, "", data.number, math.log(MOVED), step.phase, cycles=1)
    weighed = causes.weigh_causes(
        (*history.cycles, data)[-REMEMBERED:],
        history.reported,
        signs,
        length_seen=cycle.length_seen,
        steps=[moved],
    )
    lasting = 1.0 + sum(c.weight for c in weighed if c.name in LASTING)
    return lasting >= SURE * (1.0 + sum(c.weight for c in weighed))


def _weigh(history: History, cycle: CycleSeen, signs: Signatures) -> list[causes.Candidate]:
    return causes.weigh_causes(
        history.cycles, history.reported, signs, length_seen=cycle.length_seen
    )


# --- position of the robot after the twin was late or had no data for a time --------------------------


def _place(
    history: History, cycle: CycleSeen, data: CycleData
) -> tuple[History, CycleData, list[Finding]]:
    """Reset the robot's position to the tracker's if the position is unknown, or after a time without data."""
    if data.step is None or not (history.unplaced or history.blind_s):
        return history, data, []
    size, variance = data.step.size, data.variance.copy()
    variance[POSITION] = np.inf
    data = replace(data, step=Step(0.0), variance=variance)
    # If the twin joined in this cycle, the next cycle still depends on the unknown start.
    unknown = replace(history, unplaced=cycle.joined, blind_s=0.0)
    if history.unplaced:
        if not cycle.joined and abs(size) <= STEP_M:
            return unknown, data, []
        text = "the twin resets its position to the tracker's"
        return unknown, data, [Finding(cycle.number, text, shift=size, explains_position=True)]
    grooves = _whole(size, cycle)
    if not grooves:
        return unknown, data, []
    where = "further" if grooves * cycle.gait.direction > 0 else "less far"
    text = (
        f"no data for {history.blind_s:.1f} s; afterwards the robot is {_count_of_grooves(grooves)} {where} than "
        f"predicted (position {1e3 * size:+.1f} mm off); the twin corrects its anchors"
    )
    return (
        unknown,
        data,
        [Finding(cycle.number, text, GAP, grooves=grooves, explains_position=True)],
    )


def _whole(size: float, cycle: CycleSeen) -> int:
    """Return the size of a step along +x, from m to grooves; 0 if it is no whole number of grooves."""
    grooves = round(size / cycle.parameters.pitch)
    return grooves if abs(size - grooves * cycle.parameters.pitch) <= 4.0 * WHOLE_M else 0


# --- a step that the tracker saw ------------------------------------------------------------------------


def _settle(
    history: History, cycle: CycleSeen, step: Step, shares: Mapping[EventCode, float]
) -> tuple[History, Finding | None]:
    """Return the history with the cause of a step, and the finding; None if the step is not reported (yet).

    Near an edge the twin silently follows the grooves that a healthy robot gains.
    """
    best = max(shares, key=lambda code: shares[code])
    if best == NO_STEP:
        return replace(history, slight=False), None
    if best == CAMERA_MOVED and abs(step.size) < SLIGHT_M and not history.slight:
        return replace(history, slight=True), None
    finding = _explain(cycle, step, shares)
    gained = finding.grooves * cycle.gait.direction
    name = _NAMES.get(finding.code, "")
    usual = history.cycles[-1].at_edge(gained) > 0.0
    if usual:
        name = "missed" if gained < 0 else "gained"
        finding = replace(finding, silent=True)
    elif name:
        finding = _again(finding, history.reported, gained, cycle.predicted)
    cause = causes.ReportedCause(name, cycle.number, gained=gained)
    reported = (*history.reported, cause)[-REMEMBERED:]
    return replace(history, slight=False, reported=reported), finding


def _again(
    finding: Finding, reported: Iterable[causes.ReportedCause], gained: int, predicted: int
) -> Finding:
    """Return the finding about grooves that were missed or gained in the previous cycle, too.

    The second cycle in a row is reported as another number of grooves per cycle, and further cycles are silent.
    """
    same = {cause.cycle for cause in reported if cause.gained == gained}
    if finding.cycle - 1 not in same:
        return finding
    text = (
        f"since cycle {finding.cycle - 1} the robot gains {predicted + gained} instead of {predicted} grooves per "
        "cycle; the twin does not report further cycles like these"
    )
    return replace(finding, description=text, silent=finding.cycle - 2 in same)


def _explain(cycle: CycleSeen, step: Step, shares: Mapping[EventCode, float]) -> Finding:
    """Return the finding that attributes a step to a fin, a person who moved the robot, or the camera."""
    best = max(shares, key=lambda code: shares[code])
    probability = shares[best]
    missed = sum(shares[code] for code in (MISSED_REAR, MISSED_FRONT, MISSED))
    grooves = _whole(step.size, cycle)
    gained = grooves * cycle.gait.direction
    number, since_s = _count_of_grooves(gained), step.phase * cycle.gait.period
    when = f"(position {1e3 * step.size:+.1f} mm off, beginning {since_s:.1f} s into the cycle)"
    corrects = "; the twin corrects its anchors"
    if missed >= SURE:
        if probability < SURE:
            best, probability = MISSED, missed
        text = f"the robot missed {number}{_FINS.get(best, '')} {when}{corrects}"
    elif probability < SURE:
        likely = {c.phrase: shares[c] for c in (ROBOT_MOVED, CAMERA_MOVED, GAINED, NO_STEP)}
        likely[MISSED.phrase] = missed
        likely = {phrase: share for phrase, share in likely.items() if share > LIKELY}
        best, probability = AMBIGUOUS, max(likely.values())
        text = f"the cause is ambiguous: {_list_of_candidates(likely)} {when}"
        text += corrects if grooves else ""
    elif best == GAINED:
        text = f"the robot gained {number} too many {when}{corrects}"
    elif best == ROBOT_MOVED:
        way = "along" if gained > 0 else "against"
        text = f"the robot was moved by {number} {way} the direction of its gait {when}{corrects}"
    else:
        text = (
            f"the camera was moved: its positions are {1e3 * step.size:+.1f} mm off, which is no whole number of "
            "grooves; the twin shifts its origin"
        )
    follows_camera = best == CAMERA_MOVED or not grooves
    return Finding(
        cycle.number,
        text,
        best,
        probability,
        grooves=0 if follows_camera else grooves,
        shift=step.size if follows_camera else 0.0,
        explains_position=True,
    )


def _shares_of_step(
    cycle: CycleSeen,
    data: CycleData,
    step: Step,
    weighed: Sequence[causes.Candidate],
    signs: Signatures,
) -> dict[EventCode, float]:
    """Return the probability of each code that can explain a step."""
    pitch, grooves = cycle.parameters.pitch, _whole(step.size, cycle)
    gained = grooves * cycle.gait.direction
    shares = dict.fromkeys((MISSED_REAR, MISSED_FRONT, MISSED, GAINED, ROBOT_MOVED), 0.0)
    swift = {who: p if step.swift else 1.0 - p for who, p in SWIFT.items()}
    shares[CAMERA_MOVED] = MOVED * _normal(step.size, causes.CAMERA_M) * swift["camera"]
    shares[NO_STEP] = _normal(step.size, WHOLE_M)
    if grooves:
        whole = _normal(step.size - grooves * pitch, WHOLE_M)
        shares[ROBOT_MOVED] = MOVED / (2 * MOST_GROOVES) * whole * swift["robot"]
        missed = gained < 0
        usual = causes.MISS * MORE ** (-gained - 1) if missed else causes.GAIN
        chance = whole * swift["fin"] * (2.0 * usual + data.at_edge(gained))
        changes = signs.missed if missed else signs.gained
        if (missed and -gained <= max(signs.grooves, 1)) or gained == 1:
            shares[MISSED if missed else GAINED] = ANY_TIME * chance
            for fin, change in changes.items():
                code = MISSED_BY_FIN[fin] if missed else GAINED
                timely = _normal(step.phase - _phase_of_slip(change[1, POSITION], pitch), TIMING)
                evidence = _evidence(weighed, code, fin, cycle.number)
                shares[code] += (1.0 - ANY_TIME) / len(changes) * chance * timely * evidence
    total = sum(shares.values())
    return {code: share / total for code, share in shares.items()}


def _phase_of_slip(position: Array, pitch: float) -> float:
    """Return the phase at which a position residual (m), shape (BINS,), first exceeds half a pitch."""
    return float(np.argmax(np.abs(position) > 0.5 * pitch)) / BINS


def _evidence(weighed: Sequence[causes.Candidate], code: EventCode, fin: str, number: int) -> float:
    """Return the Bayes factor of a groove that a fin missed or gained in a cycle; 1 if this was not weighed."""
    wanted = (code, fin, number, 1)
    matching = [c for c in weighed if (c.code, c.name, c.cycle, c.cycles) == wanted]
    return matching[0].weight / math.exp(matching[0].log_prior) if matching else 1.0


def _normal(value: float, spread: float) -> float:
    return math.exp(-0.5 * (value / spread) ** 2) / (spread * math.sqrt(2.0 * math.pi))


# --- L0 ---------------------------------------------------------------------------------------------------


def _length(
    history: History, cycle_seen: CycleSeen, weighed: Sequence[causes.Candidate]
) -> tuple[History, Finding | None]:
    """Return a new L0 as a finding if a wrong L0 has at least the probability 1 − HEALTHY_AT_MOST.

    A tracker must have seen the end of at least `LENGTHS` cycles.
    """
    lengths = [c for c in weighed if c.code == INITIAL_LENGTH]
    share = sum(c.weight for c in lengths) / (1.0 + sum(c.weight for c in weighed))
    settled = sum(cycle.step is not None for cycle in history.cycles)
    if share < 1.0 - HEALTHY_AT_MOST or settled < LENGTHS:
        return history, None
    best = max(lengths, key=lambda c: c.weight)
    before = cycle_seen.parameters.initial_length
    after = before + best.error
    text = (
        f"L0 is {1e3 * after:.1f} mm instead of {1e3 * before:.1f} mm, according to positions and power since the run "
        "began"
    )
    finding = Finding(
        cycle_seen.number,
        text,
        INITIAL_LENGTH,
        share,
        initial_length=after,
        explains_position=True,
    )
    return History(unplaced=True), finding


# --- causes that the data show without a step ----------------------------------------------------------


def judge_causes(
    history: History, number: int, weighed: Sequence[causes.Candidate]
) -> tuple[History, list[Finding]]:
    """Return the updated history, and the findings if the robot is probably not healthy.

    Steps of the position that the tracker saw are not among the findings.
    """
    total = 1.0 + sum(c.weight for c in weighed)
    if 1.0 / total > HEALTHY_AT_MOST:
        return replace(history, doubt=False), []
    history, findings = _grooves_by_power(history, weighed, total)
    healthy = 1.0 + sum(c.weight for c in weighed if c.healthy)
    if healthy / total > HEALTHY_AT_MOST:
        return replace(history, doubt=False), findings
    reported: list[causes.ReportedCause] = []
    for group in _by_code([c for c in weighed if c.name in LASTING]).values():
        share, best = _share(group, total), max(group, key=lambda c: c.weight)
        if share < SURE or (best.cycle >= number and best.phase >= LASTED):
            continue
        names = {candidate.name for candidate in group}
        if not _is_known(history.reported, best, names):
            tracked = any(cycle.step is not None for cycle in history.cycles)
            findings.append(_lasting(group, best, share, tracked=tracked))
        reported += [causes.ReportedCause(name, best.cycle, best.phase) for name in sorted(names)]
    if reported or findings:
        reported = [*history.reported, *reported][-REMEMBERED:]
        return replace(history, reported=tuple(reported), doubt=False, doubted=False), findings
    if not history.doubt or history.doubted:
        return replace(history, doubt=True), []
    return replace(history, doubted=True), _doubt(number, weighed, total)


def _grooves_by_power(
    history: History, weighed: Sequence[causes.Candidate], total: float
) -> tuple[History, list[Finding]]:
    """Return the history and findings for the grooves missed or gained in cycles whose end no tracker saw."""
    findings = []
    for cycle in history.cycles:
        if cycle.watched:
            continue
        covering = [c for c in weighed if c.cycle <= cycle.number < c.cycle + c.cycles]
        shares = {
            code: _share((c for c in covering if c.code == code), total)
            for code in (MISSED_REAR, MISSED_FRONT, GAINED)
        }
        missed = shares[MISSED_REAR] + shares[MISSED_FRONT]
        best = max(shares, key=lambda code: shares[code])
        if max(missed, shares[GAINED]) >= SURE:
            best, share = (best, shares[best]) if shares[best] >= SURE else (MISSED, missed)
            text = f"the power indicates {best.phrase} (probability {100 * share:.0f} %)"
            finding = Finding(cycle.number, text, best, share)
            gained = 1 if best == GAINED else -1
            if cycle.at_edge(gained):
                finding = replace(finding, silent=True)
            else:
                finding = _again(finding, history.reported, gained, cycle.predicted)
            findings.append(finding)
            cause = causes.ReportedCause(_NAMES[best], cycle.number, gained=gained)
            history = replace(history, reported=(*history.reported, cause)[-REMEMBERED:])
    return history, findings


def _is_known(
    reported: Iterable[causes.ReportedCause], candidate: causes.Candidate, names: set[str]
) -> bool:
    """Return True if the cause was already reported as beginning in this cycle or a neighbouring one."""
    return any(t.name in names and abs(t.cycle - candidate.cycle) <= 1 for t in reported)


def _by_code(candidates: Iterable[causes.Candidate]) -> Mapping[EventCode, list[causes.Candidate]]:
    groups = defaultdict(list)
    for candidate in candidates:
        groups[candidate.code].append(candidate)
    return groups


def _share(candidates: Iterable[causes.Candidate], total: float) -> float:
    return sum(c.weight for c in candidates) / total


def _lasting(
    group: Sequence[causes.Candidate], candidate: causes.Candidate, share: float, *, tracked: bool
) -> Finding:
    """Return the finding about a lasting cause, with the other explanations that the data leave open."""
    row, total = LASTING[candidate.name], sum(c.weight for c in group)
    change = row.describe(candidate.size, candidate.deviation)
    names = {c.name for c in group} - {row.name}
    shares = {name: _share((c for c in group if c.name == name), total) for name in names}
    others = [LASTING[name].hint for name in sorted(shares) if shares[name] > LIKELY]
    others += [row.alone] if row.alone and not tracked else []
    change += f", or {' or '.join(others)}" if others else ""
    text = f"lasting change from this cycle on: {change} (probability {100 * share:.0f} %)"
    return Finding(candidate.cycle, text, candidate.code, share)


def _doubt(number: int, weighed: Sequence[causes.Candidate], total: float) -> list[Finding]:
    """Return one finding with all causes that remain possible; no finding if only a known cause remains."""
    shares = {code: _share(group, total) for code, group in _by_code(weighed).items()}
    likely = {code: share for code, share in shares.items() if share > LIKELY}
    if set(likely) == {causes.UNEXPLAINED}:
        number = max(
            (c for c in weighed if c.code == causes.UNEXPLAINED), key=lambda c: c.weight
        ).cycle
        text = "a deviation that no known cause explains"
    elif len(likely) < 2:
        return []
    else:
        candidates = _list_of_candidates({code.phrase: share for code, share in likely.items()})
        text = f"the cause is ambiguous: {candidates}"
    return [Finding(number, text, AMBIGUOUS, max(likely.values()))]


# --- phrases ---------------------------------------------------------------------------------------


def _count_of_grooves(gained: int) -> str:
    """Return a number of grooves as a phrase, without its sign."""
    return "a groove" if abs(gained) == 1 else f"{abs(gained)} grooves"


def _list_of_candidates(shares: Mapping[str, float]) -> str:
    """Return a list of phrases with their probabilities, the most probable first, separated by "or"."""
    ordered = sorted(shares, key=lambda phrase: -shares[phrase])
    return " or ".join(f"{phrase} ({100 * shares[phrase]:.0f} %)" for phrase in ordered)
