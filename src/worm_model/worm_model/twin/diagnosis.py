# SPDX-License-Identifier: Apache-2.0
"""What explains what was seen in a cycle: judged once at each cycle's end, from the sums that the core kept of it.

With a tracker the mean position residual over the cycle's last ``WINDOW`` is compared with whole grooves; the robot
is back at its length there. From power alone see `worm_model.twin.hypotheses`. If cycle after cycle gains another
number of grooves than it should, the groove phase is wrong, which decides that number: L0 is moved to the nearest
value with which the simulator predicts what was seen.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from worm_model.gait import Gait
from worm_model.parameters import Parameters
from worm_model.simulation.simulator import SimulationError, evaluate_gait
from worm_model.twin.core.memory import (
    MEASURED_POWER_SUM,
    PHASES,
    POSITION_COUNT,
    POSITION_SUM,
    POWER_COUNT,
)
from worm_model.twin.hypotheses import PowerScores, close_cycle, hypotheses

WINDOW = 0.15  # of a cycle
TOLERANCE = 0.3  # of a pitch
FEWEST = 3  # samples that make a mean
REMEMBERED = 8  # cycles
CYCLES = 2  # running that gain another number of grooves speak of L0
STEP_M = 0.0005  # in which L0 is looked for


@dataclass(frozen=True)
class CycleSeen:
    """A cycle that is over: its number from 1 on, and its sums (PHASES, SUMS).

    ``parameters`` hold the run's L0; ``length_seen`` whether an instrument gave it; ``blind_s`` how long nothing told
    of the length; ``joined`` whether the twin came to the run in this cycle.
    """

    number: int
    sums: NDArray[np.float64]
    gait: Gait
    parameters: Parameters
    length_seen: bool = False
    blind_s: float = 0.0
    joined: bool = False


@dataclass(frozen=True)
class Finding:
    """What was found, and how the twin follows it.

    ``text`` for people; ``grooves`` along +x by which the robot turned out to be further, ``shift`` (m) by which the
    tracker's zero does, ``initial_length`` L0 in m if that was found to be another; ``explains_position`` whether
    it explains the position residuals so far.
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
    """What is remembered of the cycles of a run; ``gained`` grooves more than predicted along the gait's direction."""

    gained: tuple[int, ...] = ()
    power: PowerScores = field(default_factory=PowerScores)
    missed: int = 0
    extra: int = 0


def judge_cycle(history: History, seen: CycleSeen) -> tuple[History, list[Finding]]:
    """(history, findings) once a cycle is over."""
    history, findings = _judge_grooves(history, seen)
    pair = hypotheses(seen.gait, seen.parameters)
    if pair.telling:
        sums = seen.sums
        power, found = close_cycle(
            history.power, seen.number, sums[:, MEASURED_POWER_SUM], sums[:, POWER_COUNT], pair
        )
        history = replace(history, power=power)
        findings += [
            Finding(
                "missed_groove",
                f"cycle {cycle}: its power is that of a missed groove (probability {100 * p:.0f} %)",
                cycle,
                p,
            )
            for cycle, p in found
        ]
    return history, findings


def _judge_grooves(history: History, seen: CycleSeen) -> tuple[History, list[Finding]]:
    """Whole grooves by which the tracker sees the robot off."""
    last = seen.sums[round((1.0 - WINDOW) * PHASES) :]
    count = last[:, POSITION_COUNT].sum()
    if count < FEWEST:
        return history, []
    mean = float(last[:, POSITION_SUM].sum() / count)
    if seen.joined:
        text = f"cycle {seen.number}: the twin came to it late and takes the tracker's word for where the robot stands"
        return history, [Finding("", text, seen.number, shift=mean, explains_position=True)]
    pitch, direction = seen.parameters.pitch, seen.gait.direction
    grooves = round(mean / pitch)
    if abs(mean - grooves * pitch) > TOLERANCE * pitch:
        return history, []
    gained = grooves * direction
    history = replace(history, gained=(*history.gained, gained)[-REMEMBERED:])
    if grooves == 0:
        return history, []
    count_text = "a groove" if abs(grooves) == 1 else f"{abs(grooves)} grooves"
    off = f"(position {1e3 * mean:+.1f} mm off)"
    if seen.blind_s > 0.0:
        text = (
            f"cycle {seen.number}: unknown for {seen.blind_s:.1f} s, after which the robot is {count_text} "
            f"{'further' if gained > 0 else 'behind'} {off}; the twin's anchors were moved there"
        )
        history = replace(history, gained=())
        return history, [_moved("gap", text, seen.number, grooves)]
    verb = "gained" if gained > 0 else "missed"
    text = f"cycle {seen.number}: the robot {verb} {count_text} {off}; the twin's anchors were moved there"
    code = "gained_groove" if gained > 0 else "missed_groove"
    history = replace(
        history,
        missed=history.missed + max(-gained, 0),
        extra=history.extra + max(gained, 0),
    )
    findings = [_moved(code, text, seen.number, grooves)]
    length = _length_told(history, seen)
    if length is not None:
        before = seen.parameters.initial_length
        text = (
            f"{CYCLES} cycles running gained {gained:+d} grooves more than predicted: L0 is taken as "
            f"{1e3 * length:.1f} mm instead of {1e3 * before:.1f} mm"
        )
        findings.append(Finding("initial_length", text, seen.number, initial_length=length))
        history = replace(history, gained=(), power=PowerScores())
    return history, findings


def _moved(code: str, text: str, cycle: int, grooves: int) -> Finding:
    return Finding(code, text, cycle, grooves=grooves, explains_position=True)


def _length_told(history: History, seen: CycleSeen) -> float | None:
    """L0 in m if the last cycles tell of another one, and no instrument saw it."""
    last = history.gained[-CYCLES:]
    if seen.length_seen or len(last) < CYCLES or not last[0] or len(set(last)) > 1:
        return None
    return length_for(seen.gait, seen.parameters, last[0])


def length_for(gait: Gait, parameters: Parameters, gained: int) -> float | None:
    """L0 in m nearest to the present one, within half a pitch, that gains ``gained`` more a cycle, or None."""
    nominal = replace(gait, margin=0.0)
    try:
        wanted = _grooves(nominal, parameters) + gained
        reach = np.arange(STEP_M, 0.5 * parameters.pitch, STEP_M).tolist()
        candidates = (parameters.initial_length + s * step for step in reach for s in (1, -1))
        for length in candidates:
            if _grooves(nominal, parameters.replace(initial_length=length)) == wanted:
                return float(length)
    except SimulationError:
        pass
    return None


def _grooves(gait: Gait, parameters: Parameters) -> int:
    return round(evaluate_gait(gait, parameters).grooves_per_cycle)
