# SPDX-License-Identifier: Apache-2.0
"""Events of a run as text: states of the driver, diagnostics, notices of the twin, and missing measurements."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from worm_model.bags.formats.cdr import MessageColumns
from worm_model.bags.formats.message_block import Topic
from worm_model.bags.opening import Bag
from worm_model.bags.run_reader import read_columns
from worm_model.bags.worm_topics import find_topic
from worm_model.run import POWER_VALID, Activity, Run, power_status_name, state_name
from worm_model.twin.offline_replay import Replay

_LEVELS = ("ok", "warning", "error", "stale")  # DiagnosticStatus
_SEVERITIES = ("note", "warning", "error")  # severities of the twin's notices
_DIAGNOSTICS = "/diagnostics"


@dataclass(frozen=True)
class Event:
    """Event of a run.

    Attributes:
        time: time since the first sample of the run, s; NaN for an event that concerns the whole run.
        source: ``driver``, ``twin``, name of an instrument, or name of a diagnostic status.
        level: ``note``, ``warning`` or ``error``; ``stale`` also occurs for a diagnostic status.
        text: description.
    """

    time: float
    source: str
    level: str
    text: str


Holds = Callable[[int], bool]


def events_of(bag: Bag, run: Run, holds: Holds, replay: Replay) -> tuple[Event, ...]:
    """Return all events of a part of a bag, ordered by time, followed by the events that concern the whole part.

    Args:
        bag: recording.
        run: part of the recording.
        holds: function that returns True if a stamp (ns) belongs to the part.
        replay: output of the twin for the part.
    """
    events = [*_driver_events(bag, run, holds), *_diagnostic_events(bag, run, holds)]
    events += [
        Event((n.stamp_ns - run.origin) * 1e-9, "twin", _SEVERITIES[n.severity], n.text)
        for n in replay.notices
    ]
    events.sort(key=lambda event: event.time)
    return (*events, *_missing_measurements(run))


def _driver_events(bag: Bag, run: Run, holds: Holds) -> Iterator[Event]:
    """Yield an event for each change of the driver's state or message."""
    columns = _columns(bag, find_topic(bag.channels, "gait_state"))
    if columns is None:
        return
    shown: tuple[int, str | None] | None = None
    for stamp, state, message in zip(
        _stamps(columns), columns.numbers["state"].tolist(), columns.texts["message"], strict=True
    ):
        if not holds(stamp) or (state, message) == shown:
            continue
        shown = (state, message)
        name = state_name(state)
        level = "error" if state == Activity.FAULT else "note"
        text = f"{name}: {message}" if message and message != name else name
        yield Event((stamp - run.origin) * 1e-9, "driver", level, text)


def _diagnostic_events(bag: Bag, run: Run, holds: Holds) -> Iterator[Event]:
    """Yield an event for each name and each level other than ok: the first message, and how often it was reported."""
    columns = _columns(bag, bag.topics.get(_DIAGNOSTICS))
    if columns is None:
        return
    first: dict[tuple[str, int], tuple[int, str]] = {}
    reports: Counter[str] = Counter()
    counts: Counter[tuple[str, int]] = Counter()
    for row, time in enumerate(_stamps(columns)):
        if not holds(time):
            continue
        for name, level, message in _statuses(columns, row):
            reports[name] += 1
            if level:
                first.setdefault((name, level), (time, message))
                counts[name, level] += 1
    for (name, level), (time, message) in first.items():
        kind = _LEVELS[level] if level < len(_LEVELS) else "error"
        often = f"first of {counts[name, level]} at this level, of {reports[name]} reports"
        yield Event((time - run.origin) * 1e-9, name, kind, f"{message} ({often})")


def _columns(bag: Bag, topic: Topic | None) -> MessageColumns | None:
    """Return the messages of a topic, or None if there are none."""
    columns = None if topic is None else read_columns(bag, topic)
    return columns if columns is not None and columns.numbers else None


def _stamps(columns: MessageColumns) -> list[int]:
    """Return the header stamps of messages, ns since the epoch."""
    stamp = columns.numbers["header.stamp.sec"].astype(np.int64) * 10**9
    return (stamp + columns.numbers["header.stamp.nanosec"].astype(np.int64)).tolist()


def _statuses(columns: MessageColumns, row: int) -> Iterator[tuple[str, int, str]]:
    """Yield (name, level, message) of each status in a message.

    All rows have as many status columns as the row with the most statuses. In other rows the remaining names are empty.
    """
    index = 0
    while (names := columns.texts.get(f"status[{index}].name")) is not None:
        name, message = names[row], columns.texts[f"status[{index}].message"][row]
        if name:
            yield name, int(columns.numbers[f"status[{index}].level"][row]), message or ""
        index += 1


def _missing_measurements(run: Run) -> Iterator[Event]:
    """Yield an event for each kind of power sample without a value, and for each marker that was hidden."""
    for code in sorted(set(run.power.status.tolist()) - {POWER_VALID}):
        count = int(np.count_nonzero(run.power.status == code))
        name = power_status_name(code)
        text = f"{count} of {len(run.power.status)} power samples without a value: {name}"
        yield Event(float("nan"), "power sensor", "note", text)
    for name in ("rear", "front"):
        hidden = int(np.count_nonzero(np.isnan(getattr(run.tracker, f"{name}_position"))))
        if hidden:
            text = f"{name} marker hidden in {hidden} of {len(run.tracker.stamp)} samples"
            yield Event(float("nan"), "tracker", "note", text)
