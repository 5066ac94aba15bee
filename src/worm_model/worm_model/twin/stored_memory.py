# SPDX-License-Identifier: Apache-2.0
"""Memory of the live twin at rest, as JSON text with which the replay of a recording begins.

A gait leaves the fins deflected, and may leave the slack taken up. Without a tracker, no sample of the next recording
shows this. The live twin therefore publishes its record once a second while no gait runs. The text is valid for one set
of parameters and settings, which a digest identifies.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from worm_model.twin.core.memory import MEMORY, NANOSECONDS, Memory
from worm_model.twin.data.samples import SampleKind, SampleRows
from worm_model.twin.twin import Twin, TwinState

AT_REST_NS = NANOSECONDS  # interval between stored memories
# Largest distance between a memory and the first sample. A memory from longer ago may be older than another gait.
NEAR_NS = 3 * NANOSECONDS
# fields that are not stored: samples of this process, and the number of a warning without its text
_NOT_STORED = frozenset(
    ("present", "old_in_a_row", "ahead", "filled", "place", "counts", "warning", "warned_until")
)
_STORED = tuple(name for name in MEMORY.names or () if name not in _NOT_STORED)


def is_due(state: TwinState, stored_ns: int) -> bool:
    """Return True if the memory must be stored now; ``stored_ns`` is the stamp of the last stored one, 0 without one.

    While a driver state waits, the memory would not contain its effect.
    """
    m = state.record
    waiting = state.memory.rows[int(m["place"]) : int(m["filled"])]
    stamp = int(m["processed_ns"])
    apart = abs(stamp - stored_ns) >= AT_REST_NS
    return apart and not state.is_running and not (waiting["kind"] == SampleKind.GAIT).any()


def stored_memory(twin: Twin, state: TwinState) -> str:
    """Return the memory as JSON."""
    record = {name: state.record[name].tolist() for name in _STORED}
    return json.dumps({"holds_for": digest(twin), "record": record}, separators=(",", ":"))


def digest(twin: Twin) -> str:
    """Return the digest of a twin's parameters and settings, and of the names of the stored fields."""
    content = json.dumps([asdict(twin.parameters), asdict(twin.settings), _STORED], sort_keys=True)
    return hashlib.sha256(content.encode()).hexdigest()


@dataclass(frozen=True)
class StoredMemory:
    """Memory read from a recording. It includes the effect of all samples up to ``stamp_ns``."""

    stamp_ns: int
    record: Mapping[str, Any]

    def is_new(self, rows: SampleRows) -> np.ndarray:
        """Return a mask (n,) of the samples whose effect the memory does not include."""
        received = self.record["newest"][SampleKind.GAIT]
        is_state = rows["kind"] == SampleKind.GAIT
        return np.where(is_state, rows["sent"] > received, rows["stamp"] > self.stamp_ns)

    def resume(self, twin: Twin, before: SampleRows) -> Memory:
        """Return the core's memory at the stamp, given the recording's samples ``before`` it, in order of stamp."""
        memory = twin.start().memory
        m: Any = memory.record[0]
        for name in _STORED:
            m[name] = self.record[name]
        m["present"] = m["newest"][SampleKind.GAIT + 1 :] = self.stamp_ns
        past = before[-len(memory.rows) // 2 :].copy()
        past["c"] = np.nan  # the answer to the command at these samples is not known
        memory.rows[: len(past)] = past
        m["filled"] = m["place"] = len(past)
        return memory


def memory_to_resume(
    memories: Sequence[tuple[int, str]], twin: Twin, onset_ns: int
) -> StoredMemory | None:
    """Return the memory from which a replay resumes, or None if no memory is usable.

    Args:
        memories: stamp (ns) and text of the memories near the first sample of a recording.
        twin: the twin of the replay.
        onset_ns: onset of the first gait in ns.
    """
    for stamp_ns, text in sorted(memories, reverse=True):
        record = _record(text, twin)
        if record is not None and stamp_ns <= onset_ns:
            return StoredMemory(stamp_ns, record)
    return None


def _record(text: str, twin: Twin) -> Mapping[str, Any] | None:
    """Return the record in a text; None if the text is invalid, or was stored with other parameters or settings."""
    try:
        content = json.loads(text)
        return dict(content["record"]) if content["holds_for"] == digest(twin) else None
    except (ValueError, TypeError, KeyError):
        return None
