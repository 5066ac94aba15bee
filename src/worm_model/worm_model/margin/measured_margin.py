# SPDX-License-Identifier: Apache-2.0
"""Margin of each cycle of a recorded run, measured from the tracker.

The *length* of a cycle is the travel of the body between the last switch of a fin and the turning point. The *margin*
is the increase of the switching threshold that the cycle would still have stood (`cycle_margin`). A cycle that gained
fewer grooves than the run is to gain has a negative margin.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import numpy as np

from worm_model.arrays import Array
from worm_model.gait import Gait, named_values
from worm_model.margin.cycle_margin import (
    Release,
    margin_sd,
    negative_margin,
    release_of,
    threshold_margin,
)
from worm_model.margin.fin_switch import Switches
from worm_model.margin.half_cycles import (
    TURNING_S,
    Fin,
    HalfCycle,
    Motion,
    half_cycles,
    motion_of,
)
from worm_model.margin.keeping import (
    MarginBelief,
    Probability,
    belief_of,
    keeps_probability,
)
from worm_model.margin.run_switches import FinSwitches, moved_grooves, run_switches
from worm_model.parameters import Parameters
from worm_model.run import Run
from worm_model.simulation.closed_form import deflected_share
from worm_model.simulation.smoothing import smooth

FEWEST_CYCLES = 2  # that are measured, for a statement on a run
# standard deviation of a length, because a robot differs from the template
_SHAPE_ERROR_M = 0.0002
_AT_SWITCH_S = 0.15  # half window of the length at a switch
_JUMP_S = 0.1  # duration of the jump of a module at a switch
# between two samples at the last switch or after it; in a longer gap the switch may be elsewhere, or a later one hidden
_MOST_HIDDEN_S = 0.3


@dataclass(frozen=True)
class FinMargin:
    """Measurement of one fin in one cycle: lengths and margins in m with standard deviations; NaN: not measured."""

    length: float = math.nan
    length_sd: float = math.nan
    margin: float = math.nan
    margin_sd: float = math.nan


NOT_MEASURED = FinMargin()


@dataclass(frozen=True)
class CycleMargin:
    """Measurements of both fins in a cycle, numbered from 1.

    ``grooves`` is the number that the rear module gained, ``place`` its position along the pipe in m.
    """

    cycle: int
    grooves: int
    place: float
    rear: FinMargin
    front: FinMargin


@dataclass(frozen=True)
class RunMargin:
    """Measured margins of a run.

    Attributes:
        gait: the gait.
        grooves: grooves per cycle that the margins refer to.
        cycles: one entry for each complete cycle; empty if nothing was measured.
    """

    gait: Gait
    grooves: int
    cycles: tuple[CycleMargin, ...]

    @property
    def source(self) -> str:
        """Instrument that measured the margins: "tracker", or empty without any."""
        return "tracker" if self.cycles else ""

    def margins(self, fin: Fin) -> tuple[Array, Array, Array]:
        """Return the measured margins of a fin, their standard deviations and their places, m, shape (n,) each.

        The first contraction begins from rest, and the last extension ends in rest, so they are left out.
        """
        cycles = self.cycles[1:] if fin is Fin.REAR else self.cycles[:-1]
        fins = [(cycle.rear if fin is Fin.REAR else cycle.front, cycle.place) for cycle in cycles]
        rows = [(m.margin, m.margin_sd, place) for m, place in fins if math.isfinite(m.margin)]
        margin, sd, place = np.array(rows).reshape(-1, 3).T
        return margin, sd, place

    @cached_property
    def beliefs(self) -> dict[Fin, MarginBelief]:
        """Posteriors of the margins of the fins that were measured in enough cycles."""
        measured = {fin: self.margins(fin) for fin in Fin}
        return {f: belief_of(*own) for f, own in measured.items() if own[0].size >= FEWEST_CYCLES}

    @cached_property
    def keeps(self) -> Probability | None:
        """Probability that a cycle keeps its grooves, None if a fin was not measured in enough cycles."""
        return keeps_probability(*self.beliefs.values()) if len(self.beliefs) == len(Fin) else None

    @property
    def least(self) -> MarginBelief | None:
        """Posterior of the smaller mean margin, None unless both fins were measured."""
        known = list(self.beliefs.values())
        return min(known, key=lambda fin: fin.expected) if len(known) == len(Fin) else None

    @property
    def shows_losing_fin(self) -> bool:
        """False if no cycle gains the grooves, so that the fin that loses one is assumed (`_lacking`)."""
        return max((c.grooves for c in self.cycles[1:]), default=self.grooves) >= self.grooves

    def __str__(self) -> str:
        """Return the margins of both fins and the probability to keep the grooves in one line."""
        fins = [f"{fin.value} {self.beliefs.get(fin, 'not measured')}" for fin in Fin]
        chance = f"; a cycle keeps its grooves with {self.keeps}" if self.keeps else ""
        either = (
            "" if self.shows_losing_fin else "; no cycle gains them, rear or front may lose one"
        )
        return f"{self.grooves} grooves, to spare: {', '.join(fins)}{chance}{either}"

    def as_json(self) -> dict[str, Any]:
        """Return the run as a JSON object, in SI units; None where something was not measured."""
        known = self.beliefs
        means = {
            f"{fin.value}_margin_m": known[fin].expected if fin in known else None for fin in Fin
        }
        scatter = max((each.expected_scatter for each in known.values()), default=None)
        return {
            "gait": named_values(self.gait),
            "grooves_per_cycle": self.grooves,
            "cycles": [_cycle_json(cycle) for cycle in self.cycles],
            **means,
            "scatter_m": scatter,
            "keeps_probability": None if self.keeps is None else asdict(self.keeps),
            "source": self.source,
        }


def _cycle_json(cycle: CycleMargin) -> dict[str, Any]:
    values = {
        f"{fin}_{attribute}_m": getattr(getattr(cycle, fin), attribute)
        for attribute in ("length", "length_sd", "margin", "margin_sd")
        for fin in ("rear", "front")
    }
    numbers = {name: value if math.isfinite(value) else None for name, value in values.items()}
    return {"cycle": cycle.cycle, "grooves": cycle.grooves, **numbers}


def measure_cycles(
    run: Run,
    gait: Gait,
    onset: int,
    cycles: int,
    parameters: Parameters,
    grooves: int | None = None,
) -> RunMargin:
    """Return the measured margins of a number of cycles of a gait.

    Args:
        run: a recording.
        gait: its gait.
        onset: start of the first of the cycles, ns since the epoch.
        cycles: number of complete cycles.
        parameters: parameters of the robot; approximate ones suffice.
        grooves: grooves per cycle that the gait is to gain; by default the largest number in any cycle but the first.
    """
    motion = motion_of(run, gait, onset, cycles)
    halves = half_cycles(motion, gait, cycles) if motion is not None else []
    if motion is None or not halves:
        return RunMargin(gait, grooves or 0, ())
    found = run_switches(motion, halves, parameters)
    moved = moved_grooves(motion, halves, parameters)[::2]
    places = [float(np.interp(half.end, motion.time, motion.rear)) for half in halves[::2]]
    gained = max(moved[1:] or moved)
    lengths = {fin: _lengths(motion, found[fin], gait, parameters) for fin in Fin}
    lacking = _lacking(lengths, (grooves or gained) - gained)
    fins = {
        fin: [
            _fin_margin(motion, *row, release, lacking[fin], parameters)
            for row in zip(
                *(found[fin].halves, found[fin].switches, remaining, found[fin].missing),
                strict=True,
            )
        ]
        for fin, (release, remaining) in lengths.items()
    }
    rows = zip(moved, places, fins[Fin.REAR], fins[Fin.FRONT], strict=True)
    measured = tuple(CycleMargin(cycle, *row) for cycle, row in enumerate(rows, 1))
    return RunMargin(gait, grooves or gained, measured)


def _lengths(
    motion: Motion, found: FinSwitches, gait: Gait, parameters: Parameters
) -> tuple[Release, list[float]]:
    """Return the release of a fin and the travel (m) after its last switch in each half cycle, NaN without a switch."""
    pairs = list(zip(found.halves, found.switches, strict=True))
    seen = [(half, time) for half, switches in pairs for time in switches.times]
    release = release_of(motion, seen, gait, parameters)
    return release, [_remaining(motion, *pair, release) for pair in pairs]


def _lacking(lengths: dict[Fin, tuple[Release, list[float]]], grooves: int) -> dict[Fin, int]:
    """Return how many grooves each fin lacks in every cycle of a run that gains ``grooves`` too few.

    Each groove is gained by the fin that needs the smaller additional travel for it, and the other one follows. Grooves
    that the run gains beyond the wanted ones (negative) are a surplus of both fins. Half cycles that were not measured
    do not count.
    """
    known = {fin: [one for one in of if math.isfinite(one)] for fin, (_, of) in lengths.items()}
    nearer = max(Fin, key=lambda fin: float(np.median(known[fin] or 0.0)))
    return {fin: grooves if fin is nearer else min(grooves, 0) for fin in Fin}


def _remaining(motion: Motion, half: HalfCycle, found: Switches, release: Release) -> float:
    """Return the travel (m) between the last switch of a half cycle and the turning point, NaN without a switch."""
    if not found.times:
        return math.nan
    time = found.times[-1]
    travel = half.travel(motion.front - motion.rear) - release.travel(motion.time - time)
    window, _ = motion.window(_AT_SWITCH_S)
    now = float(smooth(motion.time, travel, [time], window, window).value[0])
    return half.whole_travel - now


def _largest_gap(motion: Motion, start: float, end: float) -> float:
    """Return the longest time (s) without a sample from a switch at ``start`` to ``end``, also if it began before."""
    first = max(int(np.searchsorted(motion.time, start - _JUMP_S)) - 1, 0)
    seen = motion.time[first:]
    end = max(start, end)  # a lagging fin may switch after the turning point
    return float(np.diff(seen[seen < end], append=end).max(initial=0.0))


def _fin_margin(
    motion: Motion,
    half: HalfCycle,
    found: Switches,
    length: float,
    missing: int,
    release: Release,
    lacking: int,
    parameters: Parameters,
) -> FinMargin:
    if not math.isfinite(length):
        return NOT_MEASURED
    time, p = found.times[-1], parameters
    if _largest_gap(motion, time, half.end) > _MOST_HIDDEN_S:
        return NOT_MEASURED  # a marker was hidden at the switch or after it
    near = motion.length_at(np.array([time - 0.05, time + 0.05]))
    by_time = found.last_sd * abs(near[1] - near[0]) / 0.1
    ends = (motion.window(window)[1] for window in (_AT_SWITCH_S, TURNING_S))
    length_sd = math.hypot(by_time, *ends, _SHAPE_ERROR_M)
    share = deflected_share(p)
    short = (missing + lacking) * share * p.pitch
    margin = threshold_margin(motion, half, time, release, p) - short
    sd = margin_sd(half, time, length, length_sd, release, share)
    return FinMargin(length, length_sd, negative_margin(margin, sd) if short > 0.0 else margin, sd)
