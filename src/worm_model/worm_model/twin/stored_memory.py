# SPDX-License-Identifier: Apache-2.0
"""JSON text of the twin's memory. A replay that resumes from a recorded memory begins in the live twin's state.

The text contains the core's record by field name, the measured lengths shortly before the stamp of the memory, the
residuals of the running cycle and the history of the run. It is valid for one set of parameters and settings, which a
digest identifies.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from worm_model.twin.causes import ReportedCause
from worm_model.twin.core.memory import MEMORY, NANOSECONDS
from worm_model.twin.cycle_data import CycleData, Step
from worm_model.twin.data.samples import SAMPLE, SampleKind, SampleRows
from worm_model.twin.diagnosis import History
from worm_model.twin.twin import Twin, TwinState
from worm_msgs.gait import GAIT_DEFAULTS, WAVEFORM

VERSION = 1
AT_REST_NS = NANOSECONDS  # interval between stored memories while no gait runs
# fields that are not stored: waiting and held samples, sample counters of this process, and stamps that `resume` sets
_NOT_STORED = frozenset(("present", "old_in_a_row", "ahead", "filled", "place", "counts", "newest"))
# names in the stored format, by name of the field, where these names differ
_STORED_NAMES = {
    "processed_ns": "taken_ns",
    "reported_cycle": "told_cycle",
    "accepted": "sight",
    "accepted_ns": "sight_ns",
    "rejected": "refused",
    "rejected_ns": "refused_ns",
}
# fields that older memories lack, with their values
_DEFAULTS = {
    **{name: GAIT_DEFAULTS[name] for name in WAVEFORM if name in GAIT_DEFAULTS},
    **dict.fromkeys(("rest_ns", "pulling", "released_ns", "edge_slack", "cycle_groove"), 0),
}
# parameters that older memories lack; they were 0
_ADDED = frozenset(("rear_load", "front_load"))
#: fields by their name in the stored format
_STORED = {
    _STORED_NAMES.get(name, name): name for name in MEMORY.names or () if name not in _NOT_STORED
}


class StoringTimes:
    """Schedule of storing: once a second at rest, at the beginning and end of a run, and at the end of each cycle."""

    def __init__(self) -> None:
        self._mark: tuple[int, ...] = ()
        self._stored_ns = 0

    def is_due(self, state: TwinState) -> bool:
        """Return True if the caller must store the memory now. The schedule then counts the memory as stored."""
        m = state.record
        stamp = int(m["processed_ns"])
        mark = int(m["start_ns"]), int(m["end_ns"]), int(m["cycle"])
        apart = abs(stamp - self._stored_ns) >= AT_REST_NS
        due = bool(stamp) and (mark != self._mark or (apart and not state.is_running))
        if due:
            self._mark, self._stored_ns = mark, stamp
        return due


def stored_memory(twin: Twin, state: TwinState) -> str:
    """Return the memory as JSON."""
    memory, m = state.memory, state.record
    filled, place = int(m["filled"]), int(m["place"])
    waiting = memory.rows[place:filled]
    waiting = waiting[waiting["kind"] == SampleKind.GAIT]["sent"]
    lengths = memory.rows[:place]
    lengths = lengths[_is_stored(twin, lengths, int(m["processed_ns"]))]
    some = np.flatnonzero(memory.sums.any(axis=1))
    content = {
        "version": VERSION,
        "holds_for": digest(twin),
        "record": {name: m[field].tolist() for name, field in _STORED.items()},
        "gait_heard_ns": int(min([int(m["newest"][SampleKind.GAIT]), *(waiting - 1).tolist()])),
        "lengths": lengths.tolist(),
        "sums": {str(row): memory.sums[row].tolist() for row in some.tolist()},
        "history": _history_content(state.history if state.is_running else History()),
        "warnings": state.warnings,
        "joined_cycle": state.joined_cycle,
        "unusable": state.unusable,
    }
    return json.dumps(content, separators=(",", ":"))


def digest(twin: Twin) -> str:
    """Return the digest of a twin's parameters and settings."""
    parameters = {
        key: value for key, value in asdict(twin.parameters).items() if value or key not in _ADDED
    }
    content = json.dumps([parameters, asdict(twin.settings)], sort_keys=True)
    return hashlib.sha256(content.encode()).hexdigest()


@dataclass(frozen=True)
class StoredMemory:
    """Memory read from a recording. It includes the effect of all samples up to ``stamp_ns``."""

    stamp_ns: int
    content: Mapping[str, Any]

    @property
    def at_rest(self) -> bool:
        """True if no gait was running."""
        record = self.content["record"]
        return not record["start_ns"] or bool(record["end_ns"])

    @property
    def until_ns(self) -> int:
        """Largest stamp of a sample whose effect this memory includes. Driver states may be later than `stamp_ns`."""
        return max(self.stamp_ns, int(self.content["gait_heard_ns"]))

    def holds_for(self, twin: Twin) -> bool:
        """Return True if the twin has the parameters and settings with which this memory was stored."""
        return bool(self.content["holds_for"] == digest(twin))

    def is_new(self, rows: SampleRows) -> np.ndarray:
        """Return a mask (n,) of the samples whose effect the memory does not include."""
        sent = rows["sent"] > self.content["gait_heard_ns"]
        return np.where(rows["kind"] == SampleKind.GAIT, sent, rows["stamp"] > self.stamp_ns)

    def resume(self, twin: Twin, before: SampleRows) -> TwinState:
        """Return the twin's state at the memory's stamp, given the recording's last samples ``before`` this stamp."""
        state = twin.start()
        m = state.record
        for name, field in _STORED.items():
            m[field] = self.content["record"][name]
        m["present"] = self.stamp_ns
        m["newest"][:] = self.stamp_ns
        m["newest"][SampleKind.GAIT] = self.content["gait_heard_ns"]
        width = len(SAMPLE.names or ())
        # Older memories have fewer columns. Lengths do not use the missing columns.
        lengths = [tuple(row) + (0.0,) * (width - len(row)) for row in self.content["lengths"]]
        stored = np.array(lengths, SAMPLE)
        recent = before["stamp"] >= self.stamp_ns - look_back_ns(twin)
        recent &= ~_is_stored(twin, before, self.stamp_ns) & (before["kind"] != SampleKind.GAIT)
        past = before[recent].copy()
        past["c"][past["kind"] == SampleKind.LENGTH] = np.nan
        past = np.concatenate([stored, past])
        past = past[np.lexsort((past["kind"], past["stamp"]))][-len(state.memory.rows) // 2 :]
        state.memory.rows[: len(past)] = past
        m["filled"] = m["place"] = len(past)
        for row, sums in self.content["sums"].items():
            state.memory.sums[int(row)] = sums
        state.history = _history_of(self.content["history"])
        state.warnings = {int(number): text for number, text in self.content["warnings"].items()}
        state.joined_cycle = self.content["joined_cycle"]
        state.unusable = {int(run): text for run, text in self.content["unusable"].items()}
        return state


def read_memory(stamp_ns: int, text: str) -> StoredMemory | None:
    """Return a stored memory, or None if the text is invalid or of another version."""
    try:
        content = json.loads(text)
        content["record"] = {**_DEFAULTS, **content["record"]}
        if content["version"] != VERSION or not set(_STORED) <= set(content["record"]):
            return None
        return StoredMemory(stamp_ns, content)
    except (ValueError, TypeError, KeyError):
        return None


def memory_to_resume(
    memories: Sequence[StoredMemory], first: int | None, onsets: Sequence[int]
) -> StoredMemory | None:
    """Return the memory from which a replay resumes, or None if no memory is usable.

    The result is the first memory that is not earlier than the first sample, because the recording contains all samples
    after this memory. If a gait of the recording begins before this memory, the result is the last memory before the
    first sample instead, provided that the robot was at rest then.

    Args:
        memories: usable memories, in the order of their stamps.
        first: stamp of the first sample other than a driver state in ns, None without one.
        onsets: onsets of the gaits in ns.
    """
    if first is None:
        return None
    later = [memory for memory in memories if memory.stamp_ns >= first]
    earlier = [memory for memory in memories if memory.stamp_ns < first]
    begins = min((onset for onset in onsets if onset >= first), default=None)
    in_time = later and (begins is None or later[0].stamp_ns <= begins)
    if not in_time and begins is not None and earlier and earlier[-1].at_rest:
        return earlier[-1]
    return later[0] if later else None


def _is_stored(twin: Twin, rows: SampleRows, stamp_ns: int) -> np.ndarray:
    """Return a mask (n,) of the samples that are part of a stored memory.

    These are the measured lengths that determine the rate of the length at the stamp of the memory.
    """
    since = stamp_ns - round(twin.settings.smoothing_s * NANOSECONDS) - 1
    found: np.ndarray = (rows["kind"] == SampleKind.LENGTH) & (rows["stamp"] >= since)
    return found


def look_back_ns(twin: Twin) -> int:
    """Return how long the twin stores processed samples, ns."""
    return round((twin.settings.rest_s + twin.settings.smoothing_s + 1.0) * NANOSECONDS)


def _history_content(history: History) -> dict[str, Any]:
    content = asdict(
        history, dict_factory=lambda items: {key: _plain(value) for key, value in items}
    )
    content["told"] = content.pop("reported")  # the name in the stored format
    return content


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    return value


def _history_of(content: Mapping[str, Any]) -> History:
    cycles = tuple(
        CycleData(
            **{
                **cycle,
                "values": np.array(cycle["values"]),
                "variance": np.array(cycle["variance"]),
                "step": None if cycle["step"] is None else Step(**cycle["step"]),
            }
        )
        for cycle in content["cycles"]
    )
    reported = tuple(ReportedCause(**cause) for cause in content["told"])
    others = {key: value for key, value in content.items() if key != "told"}
    return History(**{**others, "cycles": cycles, "reported": reported})
