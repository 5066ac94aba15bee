# SPDX-License-Identifier: Apache-2.0
"""Digital twin, which turns samples into states, residuals and events.

`Twin.advance` processes the latest samples of the live robot, or the parts of a recording, with the same compiled core
(`worm_model.twin.core`). It reads no clock and draws no random numbers. The result therefore does not depend on how the
samples are divided into calls, or on the order in which the samples of the last `TwinSettings.delay_s` arrive. This
module handles the rare events: driver states, ends of cycles, jumps of the clock. To change parameters between two
calls, pass the state to another `Twin`. L0 of the present run then stays as it is.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from itertools import pairwise
from typing import Any

import numpy as np

from worm_model.parameters import PAPER, Parameters
from worm_model.run import PLAYING, SAME_ONSET_NS, Activity
from worm_model.simulation.actuation import actuator
from worm_model.simulation.closed_form import front_groove
from worm_model.simulation.kernel.actuation_law import Actuator
from worm_model.simulation.kernel.mode import Constants
from worm_model.simulation.kernel.whole_run import constants_of
from worm_model.simulation.rows import parameter_rows
from worm_model.twin import diagnosis, record_changes
from worm_model.twin.cause_table import CAMERA_MOVED, CLOCK_JUMP, GAP, NEAR_EDGE
from worm_model.twin.core import estimator, sample_buffer
from worm_model.twin.core.memory import (
    LOOK_AHEAD_NS,
    NANOSECONDS,
    VERDICTS,
    Memory,
    OutputRows,
    gait_of_run,
    new_memory,
    new_rows,
)
from worm_model.twin.data.records import Event, Severity
from worm_model.twin.data.samples import DriverState, SampleRows
from worm_model.twin.diagnosis import CycleSeen, Finding, History
from worm_model.twin.edges import Edge, edge_of
from worm_model.twin.run_margins import NO_MARGINS, MarginsAtCycle, RunPositions
from worm_model.twin.run_start import begin_run, is_new_run
from worm_model.twin.start_estimate import Start, estimate_start
from worm_model.twin.twin_settings import DEFAULTS, TwinSettings
from worm_msgs.gait import Gait

CLOCK_SET = "the clock was set{} during the gait"
BATCH = 512  # largest number of samples that are inserted before samples are processed
END_NS = 100_000_000  # longest time by which a run may end early and still complete its last cycle
FOREVER_NS = 1 << 62


@dataclass
class TwinState:
    """State of the twin between two samples; `Twin.advance` updates it in place.

    Its size is bounded, except for ``unusable`` and ``starts``, which gain an entry per such run.

    Attributes:
        memory: memory of the core.
        history: history of the run's cycles.
        warnings: texts of the last events that affect the health, by number.
        joined_cycle: cycle in which the twin joined a running gait at an unknown position; 0 if it did not.
        unusable: reasons why runs cannot be judged, by run number (by onset in ns for runs without a number).
        clock_set: True if the clock was set during a run and no run with a reported gait has begun since.
        starts: estimated starts, by onset in ns.
        positions: tracker samples from which the margins are measured.
        margins: measured margins of the run; None before the first complete cycle.
    """

    memory: Memory
    history: History = field(default_factory=History)
    warnings: dict[int, str] = field(default_factory=dict)
    joined_cycle: int = 0
    unusable: dict[int, str] = field(default_factory=dict)
    clock_set: bool = False
    starts: dict[int, Start] = field(default_factory=dict)
    positions: RunPositions = field(default_factory=RunPositions)
    margins: MarginsAtCycle | None = None

    @property
    def record(self) -> Any:
        """Record of the core, with the fields `worm_model.twin.core.memory.FIELDS`."""
        return self.memory.record[0]

    @property
    def now_ns(self) -> int:
        """Newest stamp of all samples in ns, 0 before the first sample."""
        return int(self.record["newest"].max())

    @property
    def initial_length(self) -> float:
        """L0 of the run in m."""
        return float(self.record["initial_length"])

    @property
    def direction(self) -> int:
        """Direction for which the fins are set, ±1."""
        return int(self.record["direction"])

    @property
    def is_running(self) -> bool:
        """True during a run."""
        return bool(self.record["start_ns"]) and not self.record["end_ns"]

    @property
    def gait(self) -> Gait | None:
        """Gait of the run, without the margin; None if the driver has not reported the gait."""
        m = self.record
        if not m["has_gait"]:
            return None
        return gait_of_run(m)

    @property
    def counts(self) -> dict[str, int]:
        """Number of samples by fate, such as "taken" (accepted) or "late"."""
        return dict(zip(VERDICTS, self.record["counts"].tolist(), strict=True))


@dataclass(frozen=True)
class ClosedCycle:
    """Cycle that has ended.

    Attributes:
        onset_ns: onset of the run, ns.
        number: number of the cycle, from 1.
        not_judged: reason why the cycle was not judged; empty if it was judged.
    """

    onset_ns: int
    number: int
    not_judged: str = ""


@dataclass(frozen=True)
class Output:
    """Result of `Twin.advance`, in the order of processing.

    Attributes:
        motion: rows of STATE_ROW, in which the margins are not valid.
        residuals: rows of RESIDUAL_ROW.
        lengths: rows of LENGTH_ROW, the estimated lengths.
        events: events of the twin.
        warnings: texts of the warnings to which residuals refer by number.
        cycles: cycles that have ended.
        margins: margins of the states from a row on, each with this row.
    """

    motion: np.ndarray
    residuals: np.ndarray
    lengths: np.ndarray
    events: tuple[Event, ...]
    warnings: dict[int, str]
    cycles: tuple[ClosedCycle, ...] = ()
    margins: tuple[tuple[int, MarginsAtCycle | None], ...] = ()

    @cached_property
    def states(self) -> np.ndarray:
        """Rows of STATE_ROW with the margins, which are measured now."""
        borders = [*self.margins, (len(self.motion), None)]
        for (first, margins), (end, _) in pairwise(borders):
            if first < end:
                values = NO_MARGINS if margins is None else margins.values
                for name, value in values.items():
                    self.motion[name][first:end] = value
        return self.motion


@dataclass(frozen=True)
class Twin:
    """Twin of a robot with given parameters. The state is not part of it, but an argument of its methods."""

    parameters: Parameters = PAPER
    settings: TwinSettings = DEFAULTS

    def start(self) -> TwinState:
        """Return the state before any sample."""
        return TwinState(new_memory(self.parameters.initial_length, front_groove(self.parameters)))

    def effective_parameters(self, state: TwinState) -> Parameters:
        """Return the parameters with the L0 of the state's run."""
        return _with_length(self.parameters, state.initial_length)

    def advance(self, state: TwinState, samples: SampleRows, *, to_the_end: bool = False) -> Output:
        """Process samples (n,) of SAMPLE in their order of arrival, and update the state in place.

        With ``to_the_end`` no samples follow, so that all samples are processed at once.
        """
        m = state.record
        record_changes.use_settings(m, self.settings.delay_s, self.settings[1:])
        waiting = int(m["filled"]) - int(m["place"])
        room = new_rows(2 * (len(samples) + waiting) + len(state.memory.held) + 8)
        call = _Call(self, state, room, [(0, state.margins)])
        lag_ns = int(m["delay"]) + LOOK_AHEAD_NS
        call.take(samples, lag_ns)
        call.process(-FOREVER_NS if to_the_end else lag_ns)
        states, residuals, lengths, _ = room.counts.tolist()
        return Output(
            room.states[:states],
            room.residuals[:residuals],
            room.lengths[:lengths],
            tuple(call.events),
            dict(state.warnings),
            tuple(call.cycles),
            tuple(call.margins),
        )


@dataclass
class _Call:
    """Single call of `Twin.advance`, with its decisions and events."""

    twin: Twin
    state: TwinState
    room: OutputRows
    margins: list[tuple[int, MarginsAtCycle | None]]
    events: list[Event] = field(default_factory=list)
    cycles: list[ClosedCycle] = field(default_factory=list)

    def model(self) -> tuple[Constants, Actuator, np.void]:
        """Return the parameters of the current run in the form that the core needs."""
        return _model(self.twin.effective_parameters(self.state), self.state.direction)

    def take(self, samples: SampleRows, lag_ns: int) -> None:
        """Add samples, and process all samples that are at least ``lag_ns`` older than the newest."""
        for begin in range(0, len(samples), BATCH):
            self._take_batch(samples[begin : begin + BATCH], lag_ns)

    def process(self, lag_ns: int) -> None:
        """Process all samples that are at least ``lag_ns`` older than the newest."""
        boundary = None
        while boundary != estimator.DONE:
            boundary = estimator.process(self.state.memory, lag_ns, *self.model(), self.room)
            self._report_events()
            self._cross(boundary)

    def _set_margins(self, margins: MarginsAtCycle | None) -> None:
        """Set the margins of the states that follow."""
        self.state.margins = margins
        self.margins.append((int(self.room.counts[0]), margins))

    def _take_batch(self, samples: SampleRows, lag_ns: int) -> None:
        self.state.positions.add(samples)
        first = 0
        while first < len(samples):
            jump, first = sample_buffer.insert_all(self.state.memory, samples, first)
            if jump != sample_buffer.NO_JUMP:
                self.process(-FOREVER_NS)  # process all samples from before the jump
                self._restart()
        self.process(lag_ns)

    def _cross(self, boundary: int) -> None:
        """Handle the boundary at which the core has returned."""
        m = self.state.record
        if boundary == estimator.DRIVER_STATE:
            self._apply(record_changes.next_driver_state(self.state.memory))
        elif boundary == estimator.CYCLE_END:
            self._close_cycle(int(m["cycle_end_ns"]))
        elif boundary == estimator.UNANNOUNCED_RUN:
            stamp = int(m["processed_ns"])
            self._begin(DriverState(stamp, Activity.RUNNING, None, stamp))

    def _report_events(self) -> None:
        """Report the events of the core since the last boundary."""
        count = int(self.room.counts[3])
        for kind, stamp, value in self.room.events[:count].tolist():
            if kind == estimator.GAP:
                text = f"no length for {value:.2f} s; the twin interpolates the length linearly"
                self._warn(stamp, text, GAP.code)
            elif kind == estimator.ZENO:
                text = "the predicted motion switches endlessly between two grooves: the twin was put at rest"
                self.events.append(Event(stamp, Severity.ERROR, text))
            elif kind == estimator.TRACKER_MOVED:
                text = f"the tracker's positions jumped by {1e3 * value:+.0f} mm and stayed; the twin shifts its origin"
                self._warn(stamp, text, CAMERA_MOVED.code)
        self.room.counts[3] = 0

    def _warn(self, stamp: int, text: str, code: str) -> None:
        m = self.state.record
        if self._unusable:
            return
        cycle = int(m["cycle"]) if m["cycle_end_ns"] else 0
        self.events.append(Event(stamp, Severity.WARNING, text, code, cycle, int(m["run"])))

    # --- states of the driver ---------------------------------------------------------------------

    @property
    def _unusable(self) -> str:
        """Reason why the current run cannot be judged, empty if it can."""
        m = self.state.record
        return self.state.unusable.get(int(m["run"] or m["start_ns"]), "")

    def _apply(self, driver: DriverState) -> None:
        m = self.state.record
        is_new = is_new_run(m, driver)
        record_changes.store_driver_state(m, driver)
        if is_new:
            self._end(int(m["processed_ns"]))
            self._begin(driver)
        elif self.state.is_running and driver.activity in PLAYING and driver.run:
            set_by = (driver.onset_ns - int(m["start_ns"])) / NANOSECONDS
            if driver.onset_ns and abs(set_by) * NANOSECONDS > SAME_ONSET_NS and not self._unusable:
                self._reject(driver, CLOCK_SET.format(f" by {set_by:+.1f} s"))
        elif self.state.is_running and driver.activity not in PLAYING:
            self._end(driver.stamp_ns)

    def _begin(self, driver: DriverState) -> None:
        state, twin = self.state, self.twin
        start, text = begin_run(state.memory, driver, twin.parameters, state.starts)
        m = state.record
        state.history = History()
        self._set_margins(None)
        late = start > driver.onset_ns and not m["origin_known"]
        state.joined_cycle = int(m["cycle"]) if late else 0
        self.events.append(Event(driver.stamp_ns, Severity.INFO, text, run=driver.run))
        if self._unusable or (late and state.clock_set):
            self._reject(driver, self._unusable or CLOCK_SET.format(""))
        state.clock_set = state.clock_set and driver.gait is None
        if state.gait is not None:
            self._report_edge(start, edge_of(state.gait, twin.effective_parameters(state)))
        estimator.begin_track(state.memory, start, *self.model(), self.room)

    def _report_edge(self, stamp: int, edge: Edge) -> None:
        """Report an edge once per run. From then on, a whole groove does not affect the health."""
        m = self.state.record
        if edge.is_near and not m["edge_slack"]:
            record_changes.excuse_groove(m, self.twin.parameters.pitch)
            self.events.append(
                Event(stamp, Severity.INFO, edge.text, NEAR_EDGE.code, run=int(m["run"]))
            )

    def _reject(self, driver: DriverState, reason: str) -> None:
        """Mark a run as not to be judged, and report the reason."""
        record_changes.set_start_known(self.state.record, known=False)
        self.state.unusable[driver.run or driver.onset_ns] = reason
        text = f"this gait is not judged: {reason}"
        self.events.append(
            Event(driver.stamp_ns, Severity.WARNING, text, CLOCK_JUMP.code, 0, driver.run)
        )

    def _end(self, stamp: int) -> None:
        """End a run. Judge its last cycle if the run ended at most `END_NS` before the end of that cycle."""
        m = self.state.record
        if m["cycle_end_ns"] and stamp + END_NS >= m["cycle_end_ns"]:
            self._close_cycle(stamp)
        if self.state.is_running:
            record_changes.end_run(m, stamp, is_usable=not self._unusable)

    # --- cycles ---------------------------------------------------------------------------------

    def _close_cycle(self, stamp: int) -> None:
        state, m, gait = self.state, self.state.record, self.state.gait
        assert gait is not None
        number = int(m["cycle"])
        parameters = self.twin.effective_parameters(state)
        cycle = CycleSeen(
            number,
            state.memory.sums,
            gait,
            parameters,
            np.sqrt(m["noise_square"]),
            bool(m["length_seen"]),
            float(m["blind_s"]),
            number == state.joined_cycle,
            gait.direction * int(m["rear_groove"] - m["cycle_groove"]),
        )
        not_judged = self._unusable
        if not not_judged:
            for edge in cycle.edges:
                self._report_edge(stamp, edge)
            findings, not_judged = self._judge(cycle)
            for finding in findings:
                self._follow(finding, stamp, gait)
            onset = int(m["start_ns"])
            self._set_margins(state.positions.margins(gait, parameters, onset, number))
        self.cycles.append(ClosedCycle(int(m["start_ns"]), number, not_judged))
        record_changes.close_cycle(state.memory, gait)

    def _judge(self, cycle: CycleSeen) -> tuple[list[Finding], str]:
        """Return the findings of a cycle that has ended, and the reason why the cycle is not judged, empty if it is."""
        state, m = self.state, self.state.record
        unplaced = state.history.unplaced
        history, findings = diagnosis.judge_cycle(state.history, cycle)
        if not (m["start_known"] or cycle.joined or unplaced or cycle.blind_s):
            return self._judge_first(cycle, history, findings)
        state.history = history
        if not (cycle.joined or cycle.blind_s):
            record_changes.set_start_known(m, known=True)
        if cycle.joined:
            return findings, "it began before the first sample"
        if cycle.blind_s:
            return findings, f"{cycle.blind_s:.1f} s of it are without data"
        # Without a tracker the position stays unknown. This matters only in the first complete cycle after the twin
        # joined. In later cycles the deflection of the fins no longer depends on the start.
        watched = bool(history.cycles) and history.cycles[-1].watched
        unplaced = unplaced and (watched or cycle.number == state.joined_cycle + 1)
        return findings, "the position of the robot at its beginning is unknown" if unplaced else ""

    def _judge_first(
        self, cycle: CycleSeen, history: History, findings: list[Finding]
    ) -> tuple[list[Finding], str]:
        """Judge the first cycle of a gait that began with fins in an unknown state.

        If the state with which the twin began the gait explains the cycle, the twin continues from it. Otherwise it
        estimates the start. If no start explains the cycle, the cycle is not judged.
        """
        state, m = self.state, self.state.record
        record_changes.set_start_known(m, known=True)
        off, reason = (
            diagnosis.off_at_end(cycle),
            "the state of the fins at its beginning is unknown",
        )
        if diagnosis.explains(history, cycle) and not any(
            finding.code.code for finding in findings
        ):
            state.history = history
            # Without a tracker nothing confirms this state, so the cycle is not judged.
            return findings, reason if np.isnan(off) else ""
        state.history = History()
        found = estimate_start(state.memory, cycle.parameters, int(m["motion_ns"]))
        if found is not None:
            state.starts[int(m["start_ns"])] = found.start
            record_changes.continue_from(m, found)
            text = (
                f"the gait began with bent fins, the rear module {1e3 * found.start.x1:+.1f} mm off its groove, "
                "according to the positions"
            )
            return [Finding(cycle.number, text)], ""
        text = f"is not judged: {reason}"
        if np.isnan(off):
            return [Finding(cycle.number, text)], reason
        text += "; the twin resets its position to the tracker's"
        return [Finding(cycle.number, text, shift=off, explains_position=True)], reason

    def _follow(self, finding: Finding, stamp: int, gait: Gait) -> None:
        """Report a finding, and correct the twin accordingly."""
        m = self.state.record
        record_changes.shift_origin(
            m, finding.grooves, finding.shift, explained=finding.explains_position
        )
        record_changes.fit_length(m, finding.initial_length)
        if finding.silent:
            return
        code, text = finding.code.code, finding.text
        severity = Severity.WARNING if code else Severity.INFO
        run = int(m["run"])
        self.events.append(
            Event(stamp, severity, text, code, finding.cycle, run, finding.probability)
        )
        if code:
            number = max(self.state.warnings, default=0) + 1
            self.state.warnings = {
                **dict(list(self.state.warnings.items())[-7:]),
                number: text,
            }
            record_changes.warn(m, number, gait)

    # --- the clock ------------------------------------------------------------------------------

    def _restart(self) -> None:
        """Reset the twin after a jump of the stamps, and insert the held samples, which revealed the jump.

        The counts, the texts of the warnings, the reasons why runs cannot be judged and the estimated starts are
        preserved.
        """
        state = self.state
        held = state.memory.held[: int(state.record["ahead"])].copy()
        stamp = int(held[0]["stamp"])
        off = (stamp - int(state.record["present"])) / NANOSECONDS
        text = f"stamps jumped by {off:+.1f} s: the clock was set, or samples came late; the twin restarts"
        self.events.append(Event(stamp, Severity.WARNING, text, CLOCK_JUMP.code))
        fresh = self.twin.start()
        state.clock_set = state.is_running
        record_changes.keep(fresh.record, state.record)
        state.memory, state.history, state.joined_cycle = fresh.memory, History(), 0
        sample_buffer.insert_all(state.memory, held, 0)


@lru_cache(maxsize=16)
def _with_length(parameters: Parameters, initial_length: float) -> Parameters:
    return parameters.replace(initial_length=initial_length)


@lru_cache(maxsize=16)
def _model(parameters: Parameters, direction: int) -> tuple[Constants, Actuator, np.void]:
    row = parameter_rows(parameters)[0]
    return constants_of(row, float(direction), 0.0), actuator(parameters), row
