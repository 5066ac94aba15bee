# SPDX-License-Identifier: Apache-2.0
"""Missed and extra grooves, as the tracker shows them: found at each cycle's end, and followed.

At the end of a cycle the mean position residual over its last ``WINDOW`` is compared with whole grooves. If it is
one (or more) within ``TOLERANCE``, the robot has missed or gained it, and the twin's anchors are moved there, from
``DELAY_S`` after the cycle's end on, so that samples under way do not change when it happens.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from statistics import fmean

from worm_model.twin.records import NANOSECONDS

WINDOW = 0.15  # of a cycle; the robot is back at its length at its end
TOLERANCE = 0.3  # of a pitch
FEWEST = 3  # samples that make a mean
DELAY_S = 0.2
REMEMBERED = 8  # moves whose stamps are kept


@dataclass(frozen=True)
class Move:
    """From ``stamp_ns`` on the anchors lie ``grooves`` further along +x than the motion alone would have them."""

    stamp_ns: int
    grooves: int


@dataclass(frozen=True)
class Anchors:
    """Moves so far (``base`` grooves of forgotten ones) and the residuals (m) of the running cycle's end.

    ``gained`` tells of each of the last cycles how many grooves more than predicted it gained along the
    gait's direction.
    """

    base: int = 0
    moves: tuple[Move, ...] = ()
    cycle: int = 1
    residuals: tuple[float, ...] = ()
    missed: int = 0
    extra: int = 0
    gained: tuple[int, ...] = ()

    def grooves_at(self, stamp_ns: int) -> int:
        """Grooves by which the anchors have been moved at a stamp."""
        return self.base + sum(move.grooves for move in self.moves if stamp_ns >= move.stamp_ns)

    def grooves_after(self, stamp_ns: int) -> int:
        """Grooves by which they are going to be moved after a stamp, as far as is known."""
        return sum(move.grooves for move in self.moves if stamp_ns < move.stamp_ns)


@dataclass(frozen=True)
class Cycle:
    """Which cycle of the run a stamp falls in: ``number`` from 1 on, ``phase`` in [0, 1), ``start_ns``.

    After the run the phase is NaN.
    """

    number: int
    phase: float
    start_ns: int


def cycle_at(stamp_ns: int, onset_ns: int, period_s: float) -> Cycle:
    """The cycle at a stamp of a run."""
    elapsed = (stamp_ns - onset_ns) / NANOSECONDS / period_s
    number = math.floor(elapsed + 1e-9)
    start = onset_ns + round(number * period_s * NANOSECONDS)
    return Cycle(number + 1, max(elapsed - number, 0.0), start)


def observe_anchors(
    anchors: Anchors, cycle: Cycle, residual: float, pitch: float, direction: int
) -> tuple[Anchors, str]:
    """(anchors, what happened or nothing) with a position residual (m) in a cycle."""
    text = ""
    if cycle.number > anchors.cycle:
        anchors, text = close_anchors(anchors, cycle, pitch, direction)
    if cycle.phase >= 1.0 - WINDOW:
        anchors = replace(anchors, residuals=(*anchors.residuals, residual))
    return anchors, text


def close_anchors(
    anchors: Anchors, cycle: Cycle, pitch: float, direction: int
) -> tuple[Anchors, str]:
    """(anchors, what happened or nothing) once the cycle before this one is over."""
    ended = replace(anchors, cycle=cycle.number, residuals=())
    if len(anchors.residuals) < FEWEST:
        return ended, ""
    mean = fmean(anchors.residuals)
    grooves = round(mean / pitch)
    if abs(mean - grooves * pitch) > TOLERANCE * pitch:
        return ended, ""
    ended = replace(ended, gained=(*anchors.gained, grooves * direction)[-REMEMBERED:])
    if grooves == 0:
        return ended, ""
    moves = (*anchors.moves, Move(cycle.start_ns + round(DELAY_S * NANOSECONDS), grooves))
    base = anchors.base + sum(move.grooves for move in moves[:-REMEMBERED])
    gained = grooves * direction
    count = "a groove" if abs(grooves) == 1 else f"{abs(grooves)} grooves"
    text = (
        f"cycle {anchors.cycle}: the robot {'gained' if gained > 0 else 'missed'} {count} "
        f"(position {1e3 * mean:+.1f} mm off); the twin's anchors were moved there"
    )
    ended = replace(
        ended,
        base=base,
        moves=moves[-REMEMBERED:],
        missed=ended.missed + max(-gained, 0),
        extra=ended.extra + max(gained, 0),
    )
    return ended, text
