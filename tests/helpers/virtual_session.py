# SPDX-License-Identifier: Apache-2.0
"""Sessions of gaits on the virtual robot in virtual time: the driver's own core, byte for byte, and its topics.

A session yields the samples of the twin in the order of their reception, and the true state of the plant.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import astuple, dataclass, replace
from itertools import pairwise

import numpy as np
from driver_rig import Rig, installed_robot
from recorded_run import GAIT
from twin_samples import run_of_rows

from worm_driver.control.driver_settings import DriverSettings
from worm_driver.control.robot import CycleSnapshot
from worm_driver.gait.gait_player import Phase
from worm_driver.power.ina219 import SampleStatus
from worm_driver.virtual_robot.virtual_robot import VirtualRobot
from worm_driver.virtual_robot.virtual_settings import RobotSettings
from worm_model.gait import Gait
from worm_model.run import Activity, Run
from worm_model.twin.core.memory import LOOK_AHEAD_NS
from worm_model.twin.data.records import Event
from worm_model.twin.data.samples import SAMPLE, VALUES, SampleKind
from worm_model.twin.stored_memory import is_due, stored_memory
from worm_model.twin.twin import ClosedCycle, Twin
from worm_model.twin.twin_settings import DEFAULTS

EPOCH = 1_700_000_000_000_000_000
LONGEST_S = 120.0  # of one gait
JOINED = 4, 5  # cycles of the gaits of a joined session
_ACTIVITY = {
    **dict.fromkeys((Phase.RETURNING, Phase.FLIPPING, Phase.TENSIONING), Activity.RESTING),
    Phase.HOLDING: Activity.IDLE,
}  # all others have its name


@dataclass(frozen=True)
class Played:
    """Gait of a session: its span (ns), and the grooves that x1's anchor gained along +x in each complete cycle."""

    gait: Gait
    onset_ns: int
    begin_ns: int
    end_ns: int
    grooves: tuple[int, ...]


def virtual_settings(seed: int = 1, **changes: object) -> RobotSettings:
    """Return the settings of the installed virtual robot with another seed; ``changes`` apply to its sections."""
    return replace(installed_robot(), seed=seed, **changes)


class Session:
    """One graph: a driver, and a virtual robot that continues from gait to gait."""

    def __init__(
        self, virtual: RobotSettings | None = None, driver: DriverSettings | None = None
    ) -> None:
        self.rig = Rig(driver, VirtualRobot(virtual or virtual_settings()))
        self.camera = True
        self.played: list[Played] = []
        self._rows: list[tuple[float, ...]] = []
        self._shown: tuple[object, ...] | None = None
        self._grooves: list[tuple[float, int]] = []  # time, groove of the rear anchor
        self.rig.activate()
        self._note()

    @property
    def now_ns(self) -> int:
        """Time of the robot, ns."""
        return EPOCH + round(self.rig.clock.now * 1e9)

    @property
    def rows(self) -> np.ndarray:
        """All samples so far, in order of reception."""
        return np.array(self._rows, SAMPLE)

    def rest(self, duration: float) -> None:
        """Let time (s) pass."""
        self._follow(duration, lambda _: False)

    def run(
        self,
        gait: Gait,
        cycles: int = 3,
        *,
        stop_after: float = math.inf,
        before: float = 2.0,
        after: float = 2.0,
        disturb: Callable[[VirtualRobot, float], None] = lambda _robot, _time: None,
    ) -> Played:
        """Play a gait, stopped (held at once) after a time in s from its onset.

        ``before`` and ``after`` are the times in s by which a recording begins earlier and ends later. ``disturb`` is
        called with the time since the onset.
        """
        begin = self.now_ns
        self.rest(before)
        robot, clock = self.rig.robot, self.rig.clock
        robot.start(clock.now, gait, cycles)
        self._follow(LONGEST_S, lambda s: s.player.phase is Phase.RUNNING)
        onset = robot.player.run.onset
        assert onset is not None

        def over(snapshot: CycleSnapshot) -> bool:
            run = snapshot.player.active_run
            disturb(self.rig.virtual, clock.now - onset)
            if run is not None and clock.now >= onset + stop_after:
                robot.stop(clock.now, "the service stop was called")
                return True
            return run is None

        self._follow(LONGEST_S, over)
        run = robot.player.run
        whole = run.cycles_completed(clock.now)
        borders = [self._groove_at(onset + k * gait.period) for k in range(whole + 1)]
        self.rest(after)
        played = Played(
            gait,
            EPOCH + round(onset * 1e9),
            begin,
            self.now_ns,
            tuple(b - a for a, b in pairwise(borders)),
        )
        self.played.append(played)
        return played

    # --- topics ---------------------------------------------------------------------------------

    def _follow(self, duration: float, until: Callable[[CycleSnapshot], bool]) -> None:
        end = self.rig.clock.now + duration
        while self.rig.clock.now < end - 1e-9:
            snapshot = self.rig.run(self.rig.settings.period)
            self._note()
            if until(snapshot):
                return

    def _note(self) -> None:
        rig = self.rig
        for snapshot in rig.snapshots:
            self._note_snapshot(snapshot)
        for sample in rig.samples:
            if sample.status is SampleStatus.VALID:
                self._add(SampleKind.POWER, sample.time, sample.power)
        rig.samples.clear()
        for sample in rig.virtual.take_samples():
            if self.camera:
                rear, front = sample.rear_position, sample.front_position
                self._add(SampleKind.POSITION, sample.time, rear, front)
                if math.isfinite(front - rear):
                    self._add(SampleKind.LENGTH, sample.time, front - rear)
        rig.snapshots.clear()
        rig.speeds.clear()
        rig.positions.clear()
        self._grooves.append((rig.virtual.time, rig.virtual.state.rear_groove))

    def _note_snapshot(self, snapshot: CycleSnapshot) -> None:
        player, run = snapshot.player, snapshot.player.active_run
        now = snapshot.command_time
        cycle = 0 if run is None else run.cycle(now)
        run_state = run and (run.number, run.onset, run.cycles, cycle)
        shown = (snapshot.active, snapshot.homed, player.phase, player.message, run_state)
        if shown != self._shown:
            self._shown = shown
            stamp = EPOCH + round(now * 1e9)
            state = _ACTIVITY.get(player.phase) or Activity[player.phase.name]
            state = state if snapshot.active else Activity.INACTIVE
            onset = 0 if run is None or run.onset is None else EPOCH + round(run.onset * 1e9)
            number = 0 if player.run is None else player.run.number
            gait = (0.0,) * len(VALUES) if run is None else tuple(map(float, astuple(run.gait)))
            self._rows.append((stamp, SampleKind.GAIT, onset, state, number, cycle, stamp, *gait))
        if not math.isnan(snapshot.commanded):
            self._add(SampleKind.COMMAND, now, snapshot.commanded)

    def _add(self, kind: SampleKind, time: float, a: float, b: float = 0.0) -> None:
        stamp = EPOCH + round(time * 1e9)
        self._rows.append((stamp, kind, 0, 0, 0, 0, stamp, a, b, *(0.0,) * (len(VALUES) - 2)))

    def _groove_at(self, time: float) -> int:
        return next(groove for when, groove in reversed(self._grooves) if when <= time + 1e-6)


@dataclass(frozen=True)
class Live:
    """Output of a live twin for a session, and the memories that it stored (stamp in ns, text)."""

    states: np.ndarray
    residuals: np.ndarray
    events: tuple[Event, ...]
    cycles: tuple[ClosedCycle, ...]
    memories: tuple[tuple[int, str], ...]


def live_twin(rows: np.ndarray, twin: Twin | None = None, many: int = 9) -> Live:
    """Run a twin as its node does: a few samples at a time, with its memory stored when that is due."""
    twin = twin or Twin()
    state, stored_ns = twin.start(), 0
    outputs, memories = [], []
    for k in range(0, len(rows), many):
        outputs.append(twin.advance(state, rows[k : k + many]))
        if is_due(state, stored_ns):
            stored_ns = int(state.record["processed_ns"])
            memories.append((stored_ns, stored_memory(twin.parameters, state)))
    outputs.append(twin.advance(state, rows[:0], to_the_end=True))
    return Live(
        np.concatenate([output.states for output in outputs]),
        np.concatenate([output.residuals for output in outputs]),
        tuple(event for output in outputs for event in output.events),
        tuple(cycle for output in outputs for cycle in output.cycles),
        tuple(memories),
    )


def recording(
    rows: np.ndarray, memories: Sequence[tuple[int, str]], begin_ns: int, end_ns: int
) -> Run:
    """Return a recording from ``begin_ns`` to ``end_ns``: its samples, preceded by the latched messages."""
    latched = rows[(rows["kind"] == SampleKind.GAIT) & (rows["stamp"] < begin_ns)][-1:]
    part = rows[(rows["stamp"] >= begin_ns) & (rows["stamp"] <= end_ns)]
    delay = round(DEFAULTS.delay_s * 1e9) + LOOK_AHEAD_NS
    earlier = [memory for memory in memories if memory[0] + delay < begin_ns][-1:]
    later = [memory for memory in memories if begin_ns <= memory[0] + delay <= end_ns]
    return run_of_rows(np.concatenate([latched, part]), [*earlier, *later])


def joined_session() -> Run:
    """Return one recording of two gaits; the second begins with fins that the first has deflected."""
    session = Session()
    for cycles in JOINED:
        session.run(GAIT, cycles)
    run = run_of_rows(session.rows)
    cycles = np.array([0, *JOINED])[run.gait_state.run]
    return replace(run, gait_state=replace(run.gait_state, cycles=cycles))
