# SPDX-License-Identifier: Apache-2.0
"""The digital twin: samples in, states, residuals and events out.

`Twin.advance` takes one sample live or a whole recording at replay, through the same compiled core
(`worm_model.twin.core`): no clock is read, nothing is drawn, so the outcome does not depend on how the samples are cut
into calls, nor on the order in which those of the last ``delay_s`` come. What happens a few times in a run is
decided here: the driver's words, the ends of cycles, a clock that jumps. Parameters may change between two calls
(another `Twin` on the same state); L0 stays the run's own.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np

from worm_model.gait import Gait
from worm_model.parameters import PAPER, Parameters
from worm_model.simulation.actuation import actuator
from worm_model.simulation.closed_form import front_groove
from worm_model.simulation.kernel.actuation_law import Actuator
from worm_model.simulation.kernel.mode import Constants
from worm_model.simulation.kernel.whole_run import constants_of
from worm_model.simulation.simulator import parameter_row
from worm_model.twin.core import following
from worm_model.twin.core.memory import (
    NANOSECONDS,
    POSITION,
    VERDICTS,
    Memory,
    Rows,
    Rules,
    new_memory,
    new_rows,
)
from worm_model.twin.diagnosis import CycleSeen, Finding, History, judge_cycle
from worm_model.twin.records import Activity, Event, Severity
from worm_model.twin.run_start import PLAYING, Word, begin_run, is_new_run, word_of
from worm_model.twin.samples import SAMPLE
from worm_model.twin.samples import Rows as SampleRows
from worm_model.twin.twin_settings import DEFAULTS, TwinSettings

END_NS = 100_000_000  # the driver tells of the end of a cycle with this much of a tolerance
NOTHING: SampleRows = np.zeros(0, SAMPLE)
FOREVER_NS = 1 << 62


@dataclass
class TwinState:
    """The twin between two samples; it changes as the twin advances. All of it is bounded.

    ``memory`` is the core's; ``history`` that of the run's cycles; ``warnings`` are the texts of the last events that
    count for the health, by number; ``joined_cycle`` is the cycle in which the twin came late to a run, 0 for none.
    """

    memory: Memory
    history: History = field(default_factory=History)
    warnings: dict[int, str] = field(default_factory=dict)
    joined_cycle: int = 0

    @property
    def record(self) -> Any:
        """The core's record, by field name."""
        return self.memory.record[0]

    @property
    def now_ns(self) -> int:
        """Newest stamp of all samples, 0 before the first."""
        return int(self.record["newest"].max())

    @property
    def initial_length(self) -> float:
        """L0 of the run in m."""
        return float(self.record["initial_length"])

    @property
    def direction(self) -> int:
        """In which the fins are set."""
        return int(self.record["direction"])

    @property
    def is_running(self) -> bool:
        """Whether a run goes on."""
        return bool(self.record["start_ns"]) and not self.record["end_ns"]

    @property
    def gait(self) -> Gait | None:
        """That of the run, without margin; None where no word of the driver told."""
        m = self.record
        if not m["has_gait"]:
            return None
        return Gait(float(m["stroke"]), float(m["frequency"]), int(m["direction"]))

    @property
    def counts(self) -> dict[str, int]:
        """How many samples were taken or left, by what became of them."""
        return dict(zip(VERDICTS, self.record["counts"].tolist(), strict=True))


@dataclass(frozen=True)
class Output:
    """What an advance yields: rows of STATE_ROW, RESIDUAL_ROW, LENGTH_ROW in the order of their stamps, and events.

    ``warnings`` are the texts that residuals refer to by number.
    """

    states: np.ndarray
    residuals: np.ndarray
    lengths: np.ndarray
    events: tuple[Event, ...]
    warnings: dict[int, str]


@dataclass(frozen=True)
class Twin:
    """The twin of a robot with these parameters; it holds no state."""

    parameters: Parameters = PAPER
    settings: TwinSettings = DEFAULTS

    def start(self) -> TwinState:
        """The state before any sample."""
        return TwinState(new_memory(self.parameters.initial_length, front_groove(self.parameters)))

    def effective_parameters(self, state: TwinState) -> Parameters:
        """The parameters with the L0 of the state's run."""
        return _with_length(self.parameters, state.initial_length)

    def advance(self, state: TwinState, samples: SampleRows, *, to_the_end: bool = False) -> Output:
        """Takes samples (n,) of SAMPLE in the order in which they came.

        ``to_the_end`` says that nothing comes after them, so that none waits for its time.
        """
        waiting = int(state.record["filled"]) - int(state.record["place"])
        room = new_rows(2 * (len(samples) + waiting) + len(state.memory.held) + 8)
        call = _Call(self, state, room)
        rules = call.model()[0]
        call.take(samples, rules.delay + rules.look_ahead)
        if to_the_end:
            call.take(NOTHING, -FOREVER_NS)
        states, residuals, lengths = room.counts.tolist()
        return Output(
            room.states[:states],
            room.residuals[:residuals],
            room.lengths[:lengths],
            tuple(call.events),
            dict(state.warnings),
        )


@dataclass
class _Call:
    """One advance: what Python decides in it, and what it tells."""

    twin: Twin
    state: TwinState
    room: Rows
    events: list[Event] = field(default_factory=list)

    def model(self) -> tuple[Rules, Constants, Actuator, np.ndarray]:
        """What the core needs of settings and parameters, as the run has them now."""
        parameters = self.twin.effective_parameters(self.state)
        return _model(parameters, self.state.direction, self.twin.settings)

    def take(self, samples: SampleRows, lag_ns: int) -> None:
        """Admits samples and takes those whose time has come, so far behind the newest."""
        first, why = 0, following.WORD
        while why != following.DONE:
            why, first = following.advance(
                self.state.memory, samples, first, lag_ns, *self.model(), self.room
            )
            if why in (following.WENT_BACK, following.WENT_AHEAD):
                self.take(NOTHING, -FOREVER_NS)  # the old time to its end
                self._start_anew("back" if why == following.WENT_BACK else "ahead")
            else:
                self._answer(why)

    def _answer(self, why: int) -> None:
        """Decides what the core asks."""
        m = self.state.record
        stamp = int(m["taken_ns"])
        if why == following.WORD:
            word = word_of(self.state.memory.rows[int(m["place"])])
            m["place"] += 1
            self._hear(word)
        elif why == following.CYCLE:
            self._close_cycle(int(m["cycle_end_ns"]))
        elif why == following.BEGINS:
            m["activity"] = Activity.INACTIVE
            self._begin(Word(stamp, Activity.RUNNING, None, stamp))
            m["activity"] = -1
        elif why == following.PAUSE:
            text = f"no length for {m['event_value']:.2f} s; the body is taken to have moved in a straight line"
            self._tell(int(m["paused_ns"]), text, "gap")
        elif why == following.GAVE_UP:
            text = "the motion could not be followed (the anchors switch to and fro): the twin is put at rest"
            self.events.append(Event(stamp, Severity.ERROR, text))
        elif why == following.TRACKER_MOVED:
            shift = 1e3 * m["event_value"]
            text = (
                f"the tracker's positions jumped by {shift:+.0f} mm and stayed: its zero was moved"
            )
            self._tell(stamp, text, "camera_moved")

    def _tell(self, stamp: int, text: str, code: str) -> None:
        m = self.state.record
        cycle = int(m["cycle"]) if m["cycle_end_ns"] else 0
        self.events.append(Event(stamp, Severity.WARNING, text, code, cycle, int(m["run"])))

    # --- the driver's words ---------------------------------------------------------------------

    def _hear(self, word: Word) -> None:
        m = self.state.record
        m["activity"] = word.activity
        if is_new_run(m, word):
            self._end(int(m["taken_ns"]))
            self._begin(word)
        elif self.state.is_running and word.activity not in PLAYING:
            self._end(word.stamp_ns)
        if word.activity in PLAYING:
            m["told_cycle"] = word.cycle

    def _begin(self, word: Word) -> None:
        state, twin = self.state, self.twin
        start, text = begin_run(state.memory, word, twin.parameters, twin.settings)
        m = state.record
        state.history = History()
        late = start > word.onset_ns and not m["origin_known"]
        state.joined_cycle = int(m["cycle"]) if late else 0
        self.events.append(Event(word.stamp_ns, Severity.INFO, text, run=word.run))
        rules, c, a, p = self.model()
        following.begin_track(state.memory, start, rules, c, a, p, self.room)

    def _end(self, stamp: int) -> None:
        """Ends a run; a cycle that is over but for the tolerance is judged, one that was cut off is not."""
        m = self.state.record
        if m["cycle_end_ns"] and stamp + END_NS >= m["cycle_end_ns"]:
            self._close_cycle(stamp)
        m["cycle_end_ns"] = 0
        if self.state.is_running:
            m["end_ns"] = stamp

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
        )
        state.history, findings = judge_cycle(state.history, cycle)
        for finding in findings:
            self._follow(finding, stamp, gait)
        state.memory.sums[:] = 0.0
        m["blind_s"] = 0.0
        m["cycle"] = number + 1
        m["cycle_end_ns"] = m["start_ns"] + round((number + 1) * gait.period * NANOSECONDS)

    def _follow(self, finding: Finding, stamp: int, gait: Gait) -> None:
        """Tells a finding and lets the twin follow it."""
        m = self.state.record
        m["moved"] += finding.grooves
        m["origin"] += finding.shift
        if finding.explains_position:
            m["channel_ns"][POSITION] = m["channel_level"][POSITION] = 0
        if np.isfinite(finding.initial_length):
            m["initial_length"], m["length_fitted"] = finding.initial_length, 1
        severity = Severity.WARNING if finding.code else Severity.INFO
        run = int(m["run"])
        self.events.append(
            Event(
                stamp, severity, finding.text, finding.code, finding.cycle, run, finding.probability
            )
        )
        if finding.code:
            number = max(self.state.warnings, default=0) + 1
            self.state.warnings = {
                **dict(list(self.state.warnings.items())[-7:]),
                number: finding.text,
            }
            m["warning"] = number
            m["warned_until"] = int(m["cycle_end_ns"]) + round(gait.period * NANOSECONDS)

    # --- the clock ------------------------------------------------------------------------------

    def _start_anew(self, way: str) -> None:
        """After a jump of the clock: the twin forgets the run, but for the counts, and goes on with what told of it."""
        state = self.state
        held = state.memory.held[: int(state.record["ahead"])].copy()
        counts = state.record["counts"].copy()
        stamp = int(held[0]["stamp"])
        text = f"the clock jumped {way}: the twin starts anew"
        self.events.append(Event(stamp, Severity.WARNING, text, "clock_jump"))
        fresh = self.twin.start()
        state.memory, state.history, state.joined_cycle = fresh.memory, History(), 0
        fresh.record["counts"] = counts
        rules = self.model()[0]
        for k in range(len(held)):
            following.admit(state.memory, held[k : k + 1], rules)


@lru_cache(maxsize=16)
def _with_length(parameters: Parameters, initial_length: float) -> Parameters:
    return parameters.replace(initial_length=initial_length)


@lru_cache(maxsize=16)
def _model(
    parameters: Parameters, direction: int, settings: TwinSettings
) -> tuple[Rules, Constants, Actuator, np.ndarray]:
    row = parameter_row(parameters)
    constants = constants_of(row, float(direction), 0.0)
    return rules_of(settings), constants, actuator(parameters), row


def rules_of(settings: TwinSettings) -> Rules:
    """The settings as the core takes them."""

    def ns(seconds: float) -> int:
        return round(seconds * NANOSECONDS)

    return Rules(
        delay=ns(settings.delay_s),
        look_ahead=ns(max(settings.measured_stale_s, settings.smoothing_s)),
        stale=ns(settings.measured_stale_s),
        pause=ns(settings.pause_s),
        jump_back=ns(settings.jump_back_s),
        hold_ahead=ns(settings.hold_ahead_s),
        jump_ahead=ns(settings.jump_ahead_s),
        history=ns(settings.rest_s + settings.smoothing_s + 1.0),
        period=ns(settings.output_period_s),
        moved=ns(settings.tracker_moved_s),
        smoothing=settings.smoothing_s,
        gate=settings.tracker_gate_m,
        position_scale=settings.position_scale_m,
        length_scale=settings.length_scale_m,
        power_scale=settings.power_scale_W,
    )
