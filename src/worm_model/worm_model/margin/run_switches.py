# SPDX-License-Identifier: Apache-2.0
"""Last switches of both fins in all cycles of a run, made consistent, and the grooves that a fin missed.

A fin switches at the same body length in every cycle, within a millimetre, or at a length that differs by whole
pitches: it then missed a groove, or the other fin did. So a length that fits neither is searched again with this
knowledge, and excluded if it still fits neither.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from worm_model.arrays import Array
from worm_model.margin.fin_switch import NONE, Switches, find_switches
from worm_model.margin.half_cycles import Fin, HalfCycle, Motion
from worm_model.parameters import Parameters

_UNUSUAL_M = 0.003  # difference from the usual length that is searched again
_MOST_MISSED = 2  # grooves in a half cycle
_USUAL_SD_M = 0.0015  # standard deviation of the length about the usual one in that search


@dataclass(frozen=True)
class FinSwitches:
    """Half cycles of one fin, its switches in each, and by how many grooves each is short of the run's best."""

    halves: tuple[HalfCycle, ...]
    switches: tuple[Switches, ...]
    missing: tuple[int, ...]


def run_switches(
    motion: Motion, halves: Sequence[HalfCycle], parameters: Parameters
) -> dict[Fin, FinSwitches]:
    """Return the switches of both fins in the half cycles of a run."""
    # The numbers of grooves of the first and the last half cycle are not certain.
    counts = [None, *moved_grooves(motion, halves, parameters)[1:-1], None]
    found = {}
    for fin in Fin:
        own = [k for k, half in enumerate(halves) if half.fin is fin]
        found[fin] = _of_fin(motion, [halves[k] for k in own], [counts[k] for k in own], parameters)
    return found


def _of_fin(
    motion: Motion,
    halves: Sequence[HalfCycle],
    counts: Sequence[int | None],
    parameters: Parameters,
) -> FinSwitches:
    pitch = parameters.pitch
    switches = [
        find_switches(motion, half, parameters, count)
        for half, count in zip(halves, counts, strict=True)
    ]
    places = [_place(motion, *pair) for pair in zip(halves, switches, strict=True)]
    usual = _usual([place for place, count in zip(places, counts, strict=True) if count], pitch)
    most = max((count for count in counts if count is not None), default=0)
    for k, (half, count) in enumerate(zip(halves, counts, strict=True)):
        expected = half.travel(np.asarray(half.sign * usual))
        # a fin that moved by the most grooves missed none, so its last switch is at the usual length
        missed: Array = np.arange(1.0 if count is None or count == most else _MOST_MISSED + 1.0)
        usual_places: Array = usual - pitch * missed
        if _off(places[k], usual_places) < _UNUSUAL_M or not math.isfinite(expected):
            continue
        again = find_switches(
            motion, half, parameters, count, (expected - pitch * missed, _USUAL_SD_M)
        )
        place = _place(motion, half, again)
        fits = _off(place, usual_places) < _UNUSUAL_M
        switches[k], places[k] = (again, place) if fits else (NONE, math.nan)
    missing = [
        max(round((usual - place) / pitch), 0) if math.isfinite(usual - place) else 0
        for place in places
    ]
    # The half cycle with the most grooves may be one that was not measured: then all others are short of it.
    seen = [
        count
        for count, found, short in zip(counts, switches, missing, strict=True)
        if count is not None and found.times and short == 0
    ]
    unseen = most - max(seen, default=most)
    return FinSwitches(tuple(halves), tuple(switches), tuple(short + unseen for short in missing))


def _off(place: float, usual: Array) -> float:
    """Return the distance (m) of a length from the nearest of the usual ones (n,), NaN for NaN."""
    return float(np.abs(place - usual).min())


def moved_grooves(motion: Motion, halves: Sequence[HalfCycle], parameters: Parameters) -> list[int]:
    """Return by how many grooves the sliding fin moved in each half cycle.

    The module's position is compared at two turning points at which its fin holds. The first contraction begins with
    the fin at rest in the middle of its groove, and after the last extension the front fin does not hold.
    """
    moved = []
    for index, half in enumerate(halves):
        module = motion.rear if half.fin is Fin.REAR else motion.front
        until = halves[min(index + 1, len(halves) - 1)].end
        distance = np.diff(np.interp([half.start, until], motion.time, module))[0]
        if index == 0:
            distance += 0.5 * parameters.clearance
        moved.append(max(round(float(distance) / parameters.pitch), 0))
    return moved


def _place(motion: Motion, half: HalfCycle, switches: Switches) -> float:
    """Return the body length at the last switch, m, negative for the rear fin so that it grows with the travel."""
    if not switches.times:
        return math.nan
    return half.sign * float(motion.length_at(switches.times[-1]))


def _usual(places: Sequence[float], pitch: float) -> float:
    """Return the median of those places that are within half a pitch of the farthest, NaN without any."""
    known = np.array([place for place in places if math.isfinite(place)])
    if not known.size:
        return math.nan
    middle = float(np.quantile(known, 0.5, method="lower"))  # not between two switches
    residual = known - pitch * np.round((known - middle) / pitch)  # all at one switch
    agree = known[np.abs(residual - np.median(residual)) < _UNUSUAL_M]
    return float(np.median(agree[agree > agree.max() - 0.5 * pitch])) if agree.size else math.nan
