# SPDX-License-Identifier: Apache-2.0
"""Memory of the live twin at rest, as JSON text with which the replay of a recording begins.

A gait leaves the fins deflected, and may leave the slack taken up. Without a tracker, no sample of the next recording
shows this. The live twin therefore publishes its record once a second while no gait runs. The text is valid for one set
of parameters, which it contains.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from worm_model.parameters import Parameters
from worm_model.twin.core.memory import MEMORY, NANOSECONDS, ROOM, Memory
from worm_model.twin.data.samples import SampleKind, SampleRows
from worm_model.twin.twin import TwinState

AT_REST_NS = NANOSECONDS  # interval between stored memories
# Largest distance between a memory and the first sample. A memory from longer ago may be older than another gait.
NEAR_NS = 3 * NANOSECONDS
# fields that are not stored: samples and settings of this process, and the number of a warning without its text
_NOT_STORED = frozenset(
    ("present", "old_in_a_row", "ahead", "filled", "place", "counts", "warning", "warned_until")
    + ("delay", "usual_size")
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


def stored_memory(parameters: Parameters, state: TwinState) -> str:
    """Return the memory of a twin with the given parameters as JSON."""
    record = {name: state.record[name].tolist() for name in _STORED}
    return json.dumps({"parameters": asdict(parameters), "record": record}, separators=(",", ":"))


@dataclass(frozen=True)
class StoredMemory:
    """Memory read from a recording. It includes the effect of all samples up to ``stamp_ns``."""

    stamp_ns: int
    record: Mapping[str, Any]

    def resume(self, memory: Memory) -> None:
        """Continue from this memory."""
        m: Any = memory.record[0]
        for name in _STORED:
            m[name] = self.record[name]
        m["present"] = m["newest"][SampleKind.GAIT + 1 :] = self.stamp_ns


def add_past(memory: Memory, samples: SampleRows) -> None:
    """Add samples whose effect a resumed memory includes, in order of stamp; they show the robot at rest."""
    m: Any = memory.record[0]
    past = np.concatenate([memory.rows[: int(m["place"])], samples])[-ROOM // 2 :]
    past["c"] = np.nan  # the answer to the command at these samples is not known
    memory.rows[: len(past)] = past
    m["filled"] = m["place"] = len(past)


def memory_to_resume(
    memories: Sequence[tuple[int, str]], parameters: Parameters, onset_ns: int
) -> StoredMemory | None:
    """Return the memory from which a replay resumes, or None if no memory is usable.

    Args:
        memories: stamp (ns) and text of the memories near the first sample of a recording.
        parameters: parameters of the replay.
        onset_ns: onset of the first gait in ns.
    """
    for stamp_ns, text in sorted(memories, reverse=True):
        record = _record(text, parameters)
        if record is not None and stamp_ns <= onset_ns:
            return StoredMemory(stamp_ns, record)
    return None


def _record(text: str, parameters: Parameters) -> Mapping[str, Any] | None:
    """Return the record in a text; None if the text is invalid, or was stored with other parameters or fields."""
    try:
        content = json.loads(text)
        record = dict(content["record"])
    except (ValueError, TypeError, KeyError):
        return None
    same = content.get("parameters") == asdict(parameters) and record.keys() == {*_STORED}
    return record if same else None
