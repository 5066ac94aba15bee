# SPDX-License-Identifier: Apache-2.0
"""Content of the pages about the robot: present values, state, possible actions, and the last minute."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from worm_model.analysis.run_metrics import END_TOLERANCE_NS
from worm_model.run import PLAYING, SAME_ONSET_NS, Activity, LengthSource
from worm_model.twin.data.records import StateRecord
from worm_model.twin.run_margins import spare_of
from worm_model.twin.watch_view import STALE_S
from worm_optimizer.snapshot import DriverState, Snapshot

SOURCES: Mapping[str, str] = {  # topic and the name of its source
    "body_length/commanded": "driver",
    "body_length/cable": "cable",
    "power": "power",
    "tracker": "tracker",
    "twin/state": "twin",
}
HISTORY_S = 60.0
SAMPLE_S = 0.2  # period of the history, s
MOVING = (Activity.RESTING, Activity.RUNNING, Activity.STOPPING)


def is_live(snapshot: Snapshot, topic: str, now: float) -> bool:
    """Return True if a message of a topic was received within `STALE_S`."""
    received_s = snapshot.received.get(topic)
    return received_s is not None and now - received_s <= STALE_S


def live_twin(snapshot: Snapshot, now: float) -> StateRecord | None:
    """Return the state of the twin; None if it is silent."""
    return snapshot.twin if is_live(snapshot, "twin/state", now) else None


def missing_sources(snapshot: Snapshot, now: float) -> list[str]:
    """Return a text for each source that does not publish; none if the driver is missing or inactive."""
    driver = snapshot.driver
    if driver is None or driver.state is Activity.INACTIVE:
        return []
    texts = []
    for topic, name in SOURCES.items():
        received_s = snapshot.received.get(topic)
        if received_s is None:
            texts.append(f"{name}: no message yet")
        elif now - received_s > STALE_S:
            texts.append(f"{name}: silent for {now - received_s:.0f} s")
    return texts


def state_text(snapshot: Snapshot, *, stopping: bool = False) -> str:
    """Return the state of the driver in a few words.

    Args:
        snapshot: latest state of the robot.
        stopping: True from a press of STOP to the driver's answer.
    """
    driver = snapshot.driver
    if driver is None:
        return "no driver"
    if driver.holding:
        text = "stopped, holding"
    elif stopping:
        text = f"STOP is not confirmed yet, {driver.state.name.lower()}"
    elif driver.state is Activity.INACTIVE:
        text = f"inactive: {driver.message}" if driver.message else "inactive"
    else:
        text = driver.state.name.lower()
    if driver.state in MOVING and driver.cycle:
        text += f", cycle {driver.cycle} of {driver.cycles}" if driver.cycles else ""
    if driver.state is Activity.FAULT and driver.message:
        text += f": {driver.message}"
    return f"emergency stop, {text}" if driver.emergency_stop else text


def twin_text(snapshot: Snapshot, now: float) -> str:
    """Return the health of the robot according to the twin, with the delay of the twin."""
    residuals = snapshot.residuals
    if residuals is None or not is_live(snapshot, "twin/residuals", now):
        return "twin: no message"
    age = f"{snapshot.twin_age:.1f} s behind" if math.isfinite(snapshot.twin_age) else ""
    parts = (f"twin: {residuals.health.name.lower()}", residuals.message, age)
    return ", ".join(part for part in parts if part)


def obstacles(snapshot: Snapshot, forbidden: str, hindrance: str) -> dict[str, str]:
    """Return the reason why each action is impossible now, by action; the reason is empty for a possible action.

    "Deactivate" is possible during another command, too, for example while a recording closes after STOP.

    Args:
        snapshot: latest state of the robot.
        forbidden: reason why no action is permitted.
        hindrance: reason why no other command can begin now.
    """
    driver = snapshot.driver
    if forbidden or driver is None:
        why = forbidden or "there is no driver"
        return dict.fromkeys(("Home", "Activate", "Deactivate", "Run"), why)
    off = driver.state is Activity.INACTIVE
    moving = "the robot moves" if driver.state in MOVING else ""
    blocked = "the emergency stop is on" if driver.emergency_stop else ""
    fault = "FAULT: remove the cause, then Deactivate" if driver.state is Activity.FAULT else ""
    return {
        "Home": hindrance or moving or ("" if off else "the driver is active: Deactivate first"),
        "Activate": hindrance or blocked or ("" if off else "the driver is active already"),
        "Deactivate": (hindrance and moving) or ("the driver is inactive already" if off else ""),
        "Run": hindrance
        or blocked
        or moving
        or fault
        or ("the driver is inactive: Activate first" if off else ""),
    }


def margin_text(snapshot: Snapshot, now: float, grooves: Sequence[int]) -> str:
    """Return the grooves of the last cycles and what the gait has to spare, empty without a live twin."""
    twin = live_twin(snapshot, now)
    if twin is None:
        return ""
    counted = f"grooves of the last cycles: {', '.join(map(str, grooves[-8:]))}" if grooves else ""
    phase = f"groove phase {1e3 * twin.groove_phase:.1f} mm"
    return "; ".join(filter(None, (counted, spare_of(twin), phase)))


@dataclass(frozen=True)
class Sample:
    """Values at a time (s, monotonic clock): lengths in m, powers in W; NaN for silent topics.

    ``estimated`` and ``predicted`` come from the twin and hold for the time ``twin_age`` (s) earlier.
    """

    time: float
    commanded: float
    cable: float
    measured: float
    estimated: float
    power: float
    predicted: float
    twin_age: float


def sample(snapshot: Snapshot, now: float) -> Sample:
    """Return the present values; NaN for silent topics."""
    lengths = {
        source.name.lower(): snapshot.lengths.get(source, math.nan)
        if is_live(snapshot, f"body_length/{source.name.lower()}", now)
        else math.nan
        for source in LengthSource
    }
    twin = live_twin(snapshot, now)
    return Sample(
        time=now,
        **lengths,
        power=snapshot.power if is_live(snapshot, "power", now) else math.nan,
        predicted=math.nan if twin is None else twin.power,
        twin_age=snapshot.twin_age if math.isfinite(snapshot.twin_age) else 0.0,
    )


@dataclass
class _CountedRun:
    """Run whose grooves are counted. Border n is the moment n periods after the onset."""

    onset_ns: int
    period_ns: float
    direction: int
    border: int  # number of the next border
    end_ns: int = 0  # stamp of the end of the run; 0 until it ends
    start: int | None = None  # groove at the previous border; None before the first counted border


class History:
    """Samples of the last minute, and the grooves of each cycle of the present run.

    The twin lags behind the driver. A cycle is therefore counted when the twin has passed the end of the cycle. The
    grooves of the cycle are the difference between the twin's grooves at the end and at the beginning of the cycle.

    Args:
        clock: returns the present time, s.
    """

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        self.samples: deque[Sample] = deque(maxlen=round(HISTORY_S / SAMPLE_S))
        self.grooves: list[int] = []
        self._run: _CountedRun | None = None

    def add(self, snapshot: Snapshot) -> None:
        """Add a sample. Call this every `SAMPLE_S`."""
        self.samples.append(sample(snapshot, self._clock()))
        driver = snapshot.driver
        if driver is None or not snapshot.grooves:
            return
        self._follow_driver(driver, snapshot.grooves[0][0])
        if self._run is not None:
            self._count(self._run, snapshot.grooves)

    def _follow_driver(self, driver: DriverState, oldest_ns: int) -> None:
        """Detect the beginning and the end of a run.

        ``oldest_ns`` is the stamp of the oldest stored state of the twin. If a run is already under way, its count
        begins with the first cycle that starts after this stamp.
        """
        run = self._run
        if driver.state in PLAYING and driver.onset_ns:
            if run is None or abs(driver.onset_ns - run.onset_ns) > SAME_ONSET_NS:
                period = 1e9 / driver.frequency
                first = max(math.ceil((oldest_ns - driver.onset_ns) / period), 0)
                self._run = _CountedRun(driver.onset_ns, period, driver.direction, first)
                self.grooves = []
        elif run is not None and not run.end_ns and driver.stamp_ns > run.onset_ns:
            run.end_ns = driver.stamp_ns + END_TOLERANCE_NS

    def _count(self, run: _CountedRun, states: Sequence[tuple[int, int]]) -> None:
        while True:
            border = run.onset_ns + round(run.border * run.period_ns)
            if border > states[-1][0] or (run.end_ns and border > run.end_ns):
                return
            groove = next(groove for stamp, groove in states if stamp >= border)
            if run.start is not None:
                self.grooves.append((groove - run.start) * run.direction)
            run.start, run.border = groove, run.border + 1
