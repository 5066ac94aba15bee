# SPDX-License-Identifier: Apache-2.0
"""Buffer of samples, ordered by stamp; detection of late samples, duplicates, implausible stamps and clock jumps.

"The newest" is the newest sample of all topics except the driver states.

- **Late.** A sample more than ``delay_s`` older than the newest is counted and excluded, because the estimator may
  already have used later samples. Samples that are less late are inserted by stamp, in whatever order they arrive.
- **Duplicate**, **not a number**. These samples are counted and excluded. A length, position or power that is not
  plausible counts as not a number.
- **Jump back.** The clock has jumped back if three successive late samples are older by more than `JUMP_BACK_NS` than
  the newest sample of all topics, including the driver states.
- **Ahead.** A sample that is ahead of the newest by more than `HOLD_AHEAD_NS` is held. If its stamp differs by more
  than `HOLD_AHEAD_NS` from that of the sample held last, all samples held before are excluded. Three held samples
  confirm each other. If several topics are active, they must be of at least two topics, unless 100 samples are held.
  Held driver states confirm nothing, and are excluded if their stamp is ahead of that of a sample held after them by
  more than `HOLD_AHEAD_NS`. If the first confirmed sample is at most `JUMP_AHEAD_NS` ahead, a pause has ended, and
  the held samples are inserted. If it is further ahead, the clock has jumped. If a sample other than a driver state is
  inserted before the confirmation, the held samples are excluded.
- A **driver state** is never late, because its topic is latched. A state of a running gait is inserted at the onset, or
  at the earliest stamp that is not late.
"""

from __future__ import annotations

import math

import numpy as np

from worm_model.run import Activity
from worm_model.simulation.kernel.compiled import entry, unlocked
from worm_model.twin.core.memory import (
    ACCEPTED,
    AHEAD,
    COMMAND_KIND,
    CROWDED,
    DUPLICATE,
    GAIT_KIND,
    HELD,
    KINDS,
    LATE,
    LENGTH_KIND,
    NANOSECONDS,
    NOT_A_NUMBER,
    POSITION_KIND,
    REST_S,
    ROOM,
    SMOOTHING_S,
    Memory,
)

RUNNING, STOPPING = int(Activity.RUNNING), int(Activity.STOPPING)

LONGEST_M = 1.0  # longest plausible body; excludes lengths in a wrong unit, such as mm
FARTHEST_M = 1e5  # largest plausible position
MOST_W = 1e5  # largest plausible power
CONFIRMATIONS = 3  # number of successive samples that confirm a jump; a single stamp may be wrong
# An onset that is later than its message by more than this is invalid.
ONSET_AHEAD_NS = 5 * NANOSECONDS

JUMP_BACK_NS = NANOSECONDS
HOLD_AHEAD_NS = NANOSECONDS
JUMP_AHEAD_NS = 60 * NANOSECONDS
# Processed rows are stored for at least this time, unless there are too many.
HISTORY_NS = round((REST_S + SMOOTHING_S + 1.0) * NANOSECONDS)

NO_JUMP, JUMPED = 0, 1  # of the clock


@entry
def _is_number(s: np.ndarray) -> bool:
    row = s[0]
    if row.stamp <= 0:
        return False
    if row.kind == GAIT_KIND:
        return True
    if row.kind == COMMAND_KIND:
        return abs(row.a) <= LONGEST_M
    if row.kind == LENGTH_KIND:
        return 0.0 < row.a <= LONGEST_M
    if row.kind == POSITION_KIND:
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
    """Return the index in the rows at which to insert a sample, after all processed rows."""
    m, rows = memory.record[0], memory.rows
    k = m.filled
    while k > m.place and (
        rows[k - 1].stamp > stamp or (rows[k - 1].stamp == stamp and rows[k - 1].kind > kind)
    ):
        k -= 1
    return k


@entry
def _make_room(memory: Memory) -> bool:
    """Remove the oldest processed rows; return False if there are none to remove."""
    m, rows = memory.record[0], memory.rows
    first = 0
    while first < m.place and rows[first].stamp < m.processed_ns - HISTORY_NS:
        first += 1
    if first < ROOM // 16:
        # The samples are so dense that rows younger than `HISTORY_NS` have to be removed, too.
        first = max(m.place - ROOM // 2, 0)
    for k in range(m.filled - first):
        rows[k] = rows[k + first]
    m.filled -= first
    m.place -= first
    return first > 0


@entry
def _insert_row(memory: Memory, s: np.ndarray) -> bool:
    """Insert a sample at its stamp; return False for a duplicate or without room."""
    m, rows, row = memory.record[0], memory.rows, s[0]
    if m.filled == ROOM and not _make_room(memory):
        m.counts[CROWDED] += 1
        return False
    stamp = row.stamp
    if row.kind == GAIT_KIND:
        playing = row.state == RUNNING or row.state == STOPPING
        if playing and 0 < row.onset <= row.sent + ONSET_AHEAD_NS:
            stamp = row.onset
        if m.present > 0:
            stamp = max(stamp, m.present - m.delay)
        stamp = max(stamp, m.processed_ns)
    elif m.present == 0:
        # Driver states that arrived before the first other sample take effect at the stamp of that sample.
        for k in range(m.place, m.filled):
            rows[k].stamp = max(rows[k].stamp, stamp)
    k = _place_of(memory, stamp, row.kind)
    if (
        row.kind != GAIT_KIND
        and k > 0
        and rows[k - 1].stamp == stamp
        and rows[k - 1].kind == row.kind
    ):
        m.counts[DUPLICATE] += 1
        return False
    for j in range(m.filled, k, -1):
        rows[j] = rows[j - 1]
    rows[k] = row
    rows[k].stamp = stamp
    m.filled += 1
    m.counts[ACCEPTED] += 1
    m.newest[row.kind] = max(m.newest[row.kind], row.sent)
    if row.kind != GAIT_KIND:
        m.present = max(m.present, row.stamp)
        m.old_in_a_row = 0
        m.ahead = 0
    return True


@entry
def _drop_contradicted(memory: Memory, s: np.ndarray) -> None:
    """Drop the held samples that a new sample contradicts, and the oldest held one if there is no room.

    A sample contradicts all held ones if its stamp differs by more than `HOLD_AHEAD_NS` from that of the last one.
    Driver states contradict nothing, and are dropped only if they are ahead of the sample by more than `HOLD_AHEAD_NS`.
    """
    m, held, row = memory.record[0], memory.held, s[0]
    agrees = True
    for k in range(m.ahead):
        if held[k].kind != GAIT_KIND:
            agrees = abs(row.stamp - held[k].stamp) <= HOLD_AHEAD_NS
    count = 0
    for k in range(1 if m.ahead == HELD else 0, m.ahead):
        early = held[k].stamp - row.stamp <= HOLD_AHEAD_NS
        stands = early if held[k].kind == GAIT_KIND else agrees
        if stands or row.kind == GAIT_KIND:
            held[count] = held[k]
            count += 1
    m.ahead = count


@entry
def _hold(memory: Memory, s: np.ndarray) -> int:
    """Hold a sample that is ahead. If the held samples confirm each other, insert them or return JUMPED."""
    m, held, row = memory.record[0], memory.held, s[0]
    _drop_contradicted(memory, s)
    held[m.ahead] = row
    m.ahead += 1
    if row.kind == GAIT_KIND:
        return NO_JUMP
    count, first = m.ahead, row.stamp
    alive, kinds, confirming = 0, 0, 0
    for kind in range(COMMAND_KIND, KINDS):
        recent = m.newest[kind] >= m.present - HOLD_AHEAD_NS
        alive += 1 if recent and m.newest[kind] > 0 else 0
        same = 0
        for k in range(count):
            if held[k].kind == kind:
                same += 1
                first = min(first, held[k].stamp)
        confirming += same
        kinds += 1 if same > 0 else 0
    if confirming < CONFIRMATIONS or (kinds < min(alive, 2) and count < HELD):
        return NO_JUMP
    if first - m.present > JUMP_AHEAD_NS:
        return JUMPED
    for k in range(count):
        _insert_row(memory, held[k : k + 1])
    m.counts[AHEAD] -= count
    return NO_JUMP


@entry
def insert(memory: Memory, s: np.ndarray) -> int:
    """Insert, hold or exclude a sample (a row, shape (1,)); return the jump of the clock that the sample reveals.

    After a jump ahead, `held` contains the samples that revealed it; after a jump back, the last of these samples.
    """
    m, row = memory.record[0], s[0]
    if not _is_number(s):
        m.counts[NOT_A_NUMBER] += 1
        return NO_JUMP
    if m.present > 0 and row.stamp - m.present > HOLD_AHEAD_NS:
        m.counts[AHEAD] += 1
        return _hold(memory, s)
    if row.kind == GAIT_KIND:
        if row.sent == m.newest[GAIT_KIND]:
            m.counts[DUPLICATE] += 1
        else:
            _insert_row(memory, s)
        return NO_JUMP
    if m.present == 0 or row.stamp >= max(m.present - m.delay, m.processed_ns):
        _insert_row(memory, s)
        return NO_JUMP
    if row.stamp == m.newest[row.kind]:
        m.counts[DUPLICATE] += 1
    else:
        m.counts[LATE] += 1
    if _newest(memory) - row.stamp <= JUMP_BACK_NS:
        m.old_in_a_row = 0
        return NO_JUMP
    m.old_in_a_row += 1
    if m.old_in_a_row < CONFIRMATIONS:
        return NO_JUMP
    memory.held[0] = row
    m.ahead = 1
    return JUMPED


@unlocked
def insert_all(memory: Memory, samples: np.ndarray, first: int) -> tuple[int, int]:
    """Insert samples from the index ``first`` on, up to a jump of the clock; return the jump and the next index."""
    for k in range(first, samples.shape[0]):
        jump = insert(memory, samples[k : k + 1])
        if jump != NO_JUMP:
            return jump, k + 1
    return NO_JUMP, samples.shape[0]
