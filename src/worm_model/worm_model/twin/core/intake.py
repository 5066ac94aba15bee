# SPDX-License-Identifier: Apache-2.0
"""Puts samples in the order of their stamps, and tells late ones, duplicates, wild stamps and a clock that jumps.

- **Late.** A sample that comes more than ``delay_s`` after the newest of any instrument is counted and left: those
  about it are on their way already. All others are taken in the order of their stamps, however they came.
- **Duplicate**, **not a number** (or no length, position, power of a worm): counted and left.
- **Jump back.** Three samples in a row that are all older than the newest by more than ``jump_back_s``.
- **Ahead.** A sample that is ahead of the newest by more than ``hold_ahead_s`` is held. Once three in a row agree,
  from two topics if two were alive, all of them are taken: after up to ``jump_ahead_s`` as the end of a pause, beyond
  as a clock that jumped. If a sample of the present comes before that, those held had wild stamps and are left.
- A **gait state** may be as old as it likes (it is latched); the first word of a run takes its place at the onset.
"""

from __future__ import annotations

import math

import numpy as np

from worm_model.simulation.kernel.compiled import entry
from worm_model.twin.core.memory import (
    AHEAD,
    CROWDED,
    DUPLICATE,
    KINDS,
    LATE,
    NANOSECONDS,
    NOT_A_NUMBER,
    PATIENCE,
    ROOM,
    TAKEN,
    Memory,
    Rules,
)

GAIT, COMMAND, LENGTH, POSITION = range(4)  # as in `worm_model.twin.samples.Kind`
RUNNING, STOPPING = 3, 4  # as in `worm_model.twin.records.Activity`

LONGEST_M = 1.0  # no worm is longer; a wrong unit would have the twin count millions of grooves
FARTHEST_M = 1e5  # no tracker sees farther
MOST_W = 1e5  # no worm takes more
CONFIRMATIONS = 3  # in a row: one wild stamp restarts nothing
ONSET_AHEAD_NS = 5 * NANOSECONDS  # an onset announced farther ahead is none

QUIET, JUMPED_BACK, JUMPED_AHEAD = 0, 1, 2  # what a sample says of the clock


@entry
def _is_number(s: np.ndarray) -> bool:
    row = s[0]
    if row.stamp <= 0:
        return False
    if row.kind == GAIT:
        return True
    if row.kind == COMMAND:
        return abs(row.a) <= LONGEST_M
    if row.kind == LENGTH:
        return 0.0 < row.a <= LONGEST_M
    if row.kind == POSITION:
        rear, front = row.a, row.b
        known = not math.isnan(rear) or not math.isnan(front)
        return known and not abs(rear) > FARTHEST_M and not abs(front) > FARTHEST_M
    return abs(row.a) <= MOST_W


@entry
def _newest(memory: Memory) -> int:
    newest = 0
    for kind in range(KINDS):
        newest = max(newest, memory.record[0].newest[kind])
    return newest


@entry
def _place_of(memory: Memory, stamp: int, kind: int) -> int:
    """Where a sample belongs among the rows."""
    m, rows = memory.record[0], memory.rows
    k = m.filled
    while k > m.place and (
        rows[k - 1].stamp > stamp or (rows[k - 1].stamp == stamp and rows[k - 1].kind > kind)
    ):
        k -= 1
    return k


@entry
def _make_room(memory: Memory, rules: Rules) -> bool:
    """Forgets what no window asks for any more; False if that is not enough."""
    m, rows = memory.record[0], memory.rows
    first = 0
    while first < m.place and rows[first].stamp < m.taken_ns - rules.history:
        first += 1
    if first < ROOM // 16:
        first = max(m.place - ROOM // 2, 0)  # so dense that the past has to go earlier
    for k in range(m.filled - first):
        rows[k] = rows[k + first]
    m.filled -= first
    m.place -= first
    return first > 0


@entry
def _take(memory: Memory, s: np.ndarray, rules: Rules) -> bool:
    """Puts a sample in its place; False for a duplicate or where there is no room."""
    m, rows, row = memory.record[0], memory.rows, s[0]
    if m.filled == ROOM and not _make_room(memory, rules):
        m.counts[CROWDED] += 1
        return False
    stamp = row.stamp
    if row.kind == GAIT:
        playing = row.state == RUNNING or row.state == STOPPING
        if playing and 0 < row.onset <= row.heard + ONSET_AHEAD_NS:
            stamp = row.onset
        if m.present > 0:
            stamp = max(stamp, m.present - rules.delay)
        stamp = max(stamp, m.taken_ns)
    elif m.present == 0:  # what the driver said before any instrument did applies from here on
        for k in range(m.place, m.filled):
            rows[k].stamp = max(rows[k].stamp, stamp)
    k = _place_of(memory, stamp, row.kind)
    if row.kind != GAIT and k > 0 and rows[k - 1].stamp == stamp and rows[k - 1].kind == row.kind:
        m.counts[DUPLICATE] += 1
        return False
    for j in range(m.filled, k, -1):
        rows[j] = rows[j - 1]
    rows[k] = row
    rows[k].stamp = stamp
    m.filled += 1
    m.counts[TAKEN] += 1
    m.newest[row.kind] = max(m.newest[row.kind], row.heard)
    if row.kind != GAIT:
        m.present = max(m.present, row.stamp)
        m.old_in_a_row = 0
        m.ahead = 0
    return True


@entry
def _hold(memory: Memory, s: np.ndarray, rules: Rules) -> int:
    """Holds a sample from ahead, or takes it with those before it that it agrees with."""
    m, held, row = memory.record[0], memory.held, s[0]
    kept = 0
    for k in range(m.ahead):
        if held[k].stamp <= row.stamp + rules.hold_ahead:
            held[kept] = held[k]
            kept += 1
    if kept < PATIENCE:
        held[kept] = row
        kept += 1
    m.ahead = kept
    alive, kinds = 0, 0
    for kind in range(KINDS):
        recent = m.newest[kind] >= m.present - rules.hold_ahead
        alive += 1 if kind != GAIT and recent and m.newest[kind] > 0 else 0
        for k in range(kept):
            if held[k].kind == kind:
                kinds += 1
                break
    if (kept < CONFIRMATIONS or kinds < min(alive, 2)) and kept < PATIENCE:
        return QUIET
    if held[0].stamp - m.present > rules.jump_ahead:
        return JUMPED_AHEAD
    for k in range(kept):
        _take(memory, held[k : k + 1], rules)
    m.counts[AHEAD] -= kept
    return QUIET


@entry
def admit(memory: Memory, s: np.ndarray, rules: Rules) -> int:
    """Takes a sample (a row, shape (1,)), or counts and leaves it; returns what it says of the clock.

    After a jump `held` has the samples that the new time begins with.
    """
    m, row = memory.record[0], s[0]
    if not _is_number(s):
        m.counts[NOT_A_NUMBER] += 1
        return QUIET
    if m.present > 0 and row.stamp - m.present > rules.hold_ahead:
        m.counts[AHEAD] += 1
        return _hold(memory, s, rules)
    if row.kind == GAIT:
        if row.heard == m.newest[GAIT]:
            m.counts[DUPLICATE] += 1
        else:
            _take(memory, s, rules)
        return QUIET
    if m.present == 0 or row.stamp >= max(m.present - rules.delay, m.taken_ns):
        _take(memory, s, rules)
        return QUIET
    if row.stamp == m.newest[row.kind]:
        m.counts[DUPLICATE] += 1
    else:
        m.counts[LATE] += 1
    if _newest(memory) - row.stamp <= rules.jump_back:
        m.old_in_a_row = 0
        return QUIET
    m.old_in_a_row += 1
    if m.old_in_a_row < CONFIRMATIONS:
        return QUIET
    memory.held[0] = row
    m.ahead = 1
    return JUMPED_BACK
