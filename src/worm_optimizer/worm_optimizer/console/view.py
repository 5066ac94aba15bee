# SPDX-License-Identifier: Apache-2.0
"""What a page shows of a robot: what is live and what silent, words, and what may be pressed and why not."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from worm_model.analysis.run_metrics import END_TOLERANCE_NS
from worm_model.run import SAME_ONSET_NS
from worm_model.twin.records import Activity, LengthSource
from worm_model.twin.run_start import PLAYING
from worm_model.twin.watch_view import STALE_S
from worm_optimizer.snapshot import DriverWord, Snapshot

SOURCES: Mapping[str, str] = {  # topics, by who is silent when they are
    "body_length/commanded": "driver",
    "body_length/cable": "cable",
    "power": "power",
    "tracker": "tracker",
    "twin/state": "twin",
}
REMEMBERED_S = 60.0
SAMPLE_S = 0.2  # between two samples of what is remembered
MOVING = (Activity.RESTING, Activity.RUNNING, Activity.STOPPING)


def live(snapshot: Snapshot, topic: str, now: float) -> bool:
    """Whether a topic was heard within `STALE_S`."""
    at = snapshot.heard.get(topic)
    return at is not None and now - at <= STALE_S


def silences(snapshot: Snapshot, now: float) -> list[str]:
    """Who has fallen silent, or was never heard, in words."""
    texts = []
    for topic, name in SOURCES.items():
        at = snapshot.heard.get(topic)
        if at is None:
            texts.append(f"{name}: not heard")
        elif now - at > STALE_S:
            texts.append(f"{name}: silent for {now - at:.0f} s")
    return texts


def state_words(snapshot: Snapshot, now: float) -> str:
    """What the driver does, in a few words."""
    driver = snapshot.driver
    if driver is None:
        return "no driver heard"
    words = driver.state.name.lower()
    if not live(snapshot, "body_length/commanded", now) and driver.state is not Activity.INACTIVE:
        words += ", now silent"
    if driver.state in MOVING and driver.cycle:
        words += f", cycle {driver.cycle} of {driver.cycles}" if driver.cycles else ""
    return f"emergency stop, {words}" if driver.emergency_stop else words


def twin_words(snapshot: Snapshot, now: float) -> str:
    """What the twin says of the robot's health, and how old that is."""
    residuals = snapshot.residuals
    if residuals is None or not live(snapshot, "twin/residuals", now):
        return "twin: silent"
    age = f"{snapshot.twin_age:.1f} s behind" if math.isfinite(snapshot.twin_age) else ""
    words = (f"twin: {residuals.health.name.lower()}", residuals.message, age)
    return ", ".join(word for word in words if word)


def obstacles(snapshot: Snapshot, hindrance: str) -> dict[str, str]:
    """Why each action cannot be pressed now, empty where it can be.

    ``hindrance`` says why nothing at all can be asked for, empty: something can.
    """
    driver = snapshot.driver
    if hindrance or driver is None:
        why = hindrance or "no driver is heard"
        return dict.fromkeys(("Home", "Activate", "Deactivate", "Run"), why)
    off = driver.state is Activity.INACTIVE
    moving = "the robot moves" if driver.state in MOVING else ""
    blocked = "the emergency stop is on" if driver.emergency_stop else ""
    return {
        "Home": moving or ("" if off else "its torque is on: Deactivate first"),
        "Activate": blocked or ("" if off else "its torque is on already"),
        "Deactivate": "its torque is off already" if off else "",
        "Run": blocked or moving or ("its torque is off: Activate first" if off else ""),
    }


@dataclass(frozen=True)
class Sample:
    """What is remembered of a moment: lengths in m, powers in W, NaN what is silent.

    What the twin says, ``estimated`` and ``predicted``, is older by ``twin_age`` in s.
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
    """The numbers of now, NaN where their topic is silent."""
    lengths = {
        source.name.lower(): snapshot.lengths.get(source, math.nan)
        if live(snapshot, f"body_length/{source.name.lower()}", now)
        else math.nan
        for source in LengthSource
    }
    twin = snapshot.twin if live(snapshot, "twin/state", now) else None
    return Sample(
        time=now,
        **lengths,
        power=snapshot.power if live(snapshot, "power", now) else math.nan,
        predicted=math.nan if twin is None else twin.power,
        twin_age=snapshot.twin_age if math.isfinite(snapshot.twin_age) else 0.0,
    )


@dataclass
class _CountedRun:
    """A run whose grooves are counted: ``border`` is the next end of a cycle, ``end_ns`` 0 while it goes on."""

    onset_ns: int
    period_ns: float
    direction: int
    border: int
    end_ns: int = 0
    start: int | None = None  # groove at the border before


class History:
    """A minute back, and the grooves that each cycle of the present run gained; ``clock`` returns the time in s.

    The twin is behind the driver: a cycle's grooves are those of its states at the stamps of the cycle's begin and end.
    """

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        self.samples: deque[Sample] = deque(maxlen=round(REMEMBERED_S / SAMPLE_S))
        self.grooves: list[int] = []
        self._run: _CountedRun | None = None

    def add(self, snapshot: Snapshot) -> None:
        """Remember a moment; to be called every `SAMPLE_S`."""
        self.samples.append(sample(snapshot, self._clock()))
        driver = snapshot.driver
        if driver is None or not snapshot.grooves:
            return
        self._follow_driver(driver, snapshot.grooves[0][0])
        if self._run is not None:
            self._count(self._run, snapshot.grooves)

    def _follow_driver(self, driver: DriverWord, oldest_ns: int) -> None:
        """Note a run that begins or ends; one that goes on already is counted from a cycle whose begin was seen."""
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
