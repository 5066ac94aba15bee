# SPDX-License-Identifier: Apache-2.0
"""Compares what the instruments say with the twin, once the twin has come to their stamps."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import replace

from worm_model.parameters import Parameters
from worm_model.twin.anchors import Anchors, Cycle, observe_anchors
from worm_model.twin.hypotheses import PowerWatch, hypotheses, observe_power
from worm_model.twin.phase import CYCLES, length_for
from worm_model.twin.records import (
    NANOSECONDS,
    MeasuredLength,
    Notice,
    PowerSample,
    ResidualRecord,
    Severity,
    TrackerSample,
)
from worm_model.twin.residuals import (
    LENGTH,
    POSITION,
    POWER,
    count_energy,
    forget,
    observe,
    record,
)
from worm_model.twin.track import HISTORY_S, Knot, positions_at, power_at
from worm_model.twin.twin_settings import TwinSettings
from worm_model.twin.twin_state import Observation, Sight, TwinState

TOP_SPEED = 0.15  # m/s; no gait of the paper's box is faster

CLOSE_S = 2.0 * HISTORY_S  # after its end a cycle is judged, whatever has not come by then

Comparison = tuple[TwinState, list[ResidualRecord], list[Notice]]


def compare(state: TwinState, parameters: Parameters, settings: TwinSettings) -> Comparison:
    """Judges the observations whose time has come; the rest stays, but for what is out of reach."""
    records: list[ResidualRecord] = []
    notices: list[Notice] = []
    staying: list[Observation] = []
    # A power waits for its settled prediction, a position does not: each stream keeps its own order.
    for sample in state.observations:
        judged = _judge(state, sample, parameters, settings)
        if judged is not None:
            state, found, told = judged
            records += found
            notices += told
        elif not _out_of_reach(state, sample):
            staying.append(sample)
    state = state.but(observations=tuple(staying))
    until = state.streams.now_ns - round(CLOSE_S * NANOSECONDS)
    state, told = close_cycles(state, until, parameters)
    return state, records, notices + told


def close_cycles(
    state: TwinState, until_ns: int, parameters: Parameters
) -> tuple[TwinState, list[Notice]]:
    """Judges a cycle that ended before a stamp, if no sample after it has done so."""
    cycle = state.run.cycle_at(until_ns)
    if cycle is None:
        return state, []
    stamp, cycle = state.streams.now_ns, replace(cycle, phase=math.nan)
    notices: list[Notice] = []
    if cycle.number > state.anchors.cycle:
        state, told = _watch_anchors(state, cycle, stamp, math.nan, parameters)
        notices += told
    if cycle.number > state.watch.cycle:
        state, told = _watch_power(state, cycle, stamp, math.nan, parameters)
        notices += told
    return state, notices


def _out_of_reach(state: TwinState, sample: Observation) -> bool:
    newest = state.streams.now_ns
    before_run = sample.stamp_ns < state.run.start_ns
    return before_run or newest - sample.stamp_ns > CLOSE_S * NANOSECONDS


def _judge(
    state: TwinState, sample: Observation, parameters: Parameters, settings: TwinSettings
) -> Comparison | None:
    if isinstance(sample, TrackerSample):
        return _judge_position(state, sample, parameters, settings)
    if isinstance(sample, PowerSample):
        return _judge_power(state, sample, parameters, settings)
    return _judge_length(state, sample, settings)


def _judge_power(
    state: TwinState, sample: PowerSample, parameters: Parameters, settings: TwinSettings
) -> Comparison | None:
    predicted = None if state.track is None else power_at(state.track, sample.stamp_ns)
    if predicted is None:
        return None
    power, energy = predicted
    residual = sample.power - power
    monitor = count_energy(state.monitor, sample.stamp_ns, sample.power)
    # No window resolves the step of the length rate at the onset.
    if sample.stamp_ns - state.run.start_ns > 4.0 * settings.smoothing_s * NANOSECONDS:
        monitor = observe(monitor, POWER, sample.stamp_ns, residual, settings.power_scale_W)
    state = state.but(monitor=monitor)
    notices: list[Notice] = []
    cycle = state.run.cycle_at(sample.stamp_ns)
    if cycle is not None:
        state, notices = _watch_power(state, cycle, sample.stamp_ns, sample.power, parameters)
    energy_residual = monitor.energy - energy
    found = record(state.monitor, settings, sample.stamp_ns, power=residual, energy=energy_residual)
    return state, [found], notices


def _watch_power(
    state: TwinState, cycle: Cycle, stamp_ns: int, power: float, parameters: Parameters
) -> tuple[TwinState, list[Notice]]:
    assert state.run.gait is not None
    pair = hypotheses(state.run.gait, parameters)
    if not pair.telling:
        return state, []
    watch, text = observe_power(state.watch, cycle, power, pair)
    return _warn(state.but(watch=watch), stamp_ns, cycle, text)


def _warn(
    state: TwinState, stamp_ns: int, cycle: Cycle, text: str
) -> tuple[TwinState, list[Notice]]:
    """Tells of a missed or extra groove, and keeps the health at suspect for the cycle after it."""
    if not text or state.run.gait is None:
        return state, []
    until = cycle.start_ns + round(state.run.gait.period * NANOSECONDS)
    monitor = replace(state.monitor, warning=text, warning_until_ns=until)
    return state.but(monitor=monitor), [Notice(stamp_ns, Severity.WARNING, text)]


def _judge_length(
    state: TwinState, sample: MeasuredLength, settings: TwinSettings
) -> Comparison | None:
    change = _estimate_at(state.estimates, sample.stamp_ns)
    if change is None:
        return None
    residual = sample.length - state.run.initial_length - change
    monitor = observe(state.monitor, LENGTH, sample.stamp_ns, residual, settings.length_scale_m)
    found = record(monitor, settings, sample.stamp_ns, length=residual)
    return state.but(monitor=monitor), [found], []


def _estimate_at(estimates: Sequence[Knot], stamp_ns: int) -> float | None:
    k = bisect_left(estimates, stamp_ns, key=_stamp)
    if k == len(estimates):
        return None
    after = estimates[k]
    if after.stamp_ns == stamp_ns:
        return after.length_change
    if k == 0:
        return None
    before = estimates[k - 1]
    share = (stamp_ns - before.stamp_ns) / (after.stamp_ns - before.stamp_ns)
    return before.length_change + share * (after.length_change - before.length_change)


def _stamp(knot: Knot) -> int:
    return knot.stamp_ns


def _judge_position(
    state: TwinState, sample: TrackerSample, parameters: Parameters, settings: TwinSettings
) -> Comparison | None:
    expected = None if state.track is None else positions_at(state.track, sample.stamp_ns)
    if expected is None or math.isnan(sample.rear_position):
        return None
    sight, accepted = look(state.sight, sample, settings)
    if math.isnan(state.sight.position) and not state.run.start_ns:
        # Before the first run the tracker's first word says where the robot stands.
        state = state.but(run=replace(state.run, origin=sample.rear_position - expected[0]))
    shifted = state.anchors.grooves_at(sample.stamp_ns) * parameters.pitch
    residual = sample.rear_position - (expected[0] + shifted + state.run.origin)
    if not accepted:
        return _refuse(state.but(sight=sight), sample, residual, settings)
    # What a move that is under way explains is no fault any more.
    fault = residual - state.anchors.grooves_after(sample.stamp_ns) * parameters.pitch
    monitor = observe(state.monitor, POSITION, sample.stamp_ns, fault, settings.position_scale_m)
    state = state.but(sight=sight, monitor=monitor)
    notices: list[Notice] = []
    cycle = state.run.cycle_at(sample.stamp_ns)
    if cycle is not None:
        state, notices = _watch_anchors(state, cycle, sample.stamp_ns, residual, parameters)
    return state, [record(state.monitor, settings, sample.stamp_ns, position=residual)], notices


def look(sight: Sight, sample: TrackerSample, settings: TwinSettings) -> tuple[Sight, bool]:
    """(the sight, whether the position is a possible one): it cannot jump."""
    elapsed = max(sample.stamp_ns - sight.stamp_ns, 0) / NANOSECONDS
    jump = abs(sample.rear_position - sight.position)
    # The negation lets the first pass, whose jump is NaN.
    if not jump > settings.tracker_gate_m + TOP_SPEED * elapsed:
        return Sight(sample.stamp_ns, sample.rear_position), True
    agrees = abs(sample.rear_position - sight.refused) <= settings.tracker_gate_m
    if not agrees:
        sight = replace(sight, refused_ns=sample.stamp_ns, refused=sample.rear_position)
    return sight, False


def stays(sight: Sight, stamp_ns: int, settings: TwinSettings) -> bool:
    """Whether refused positions have agreed for so long that the tracker must have been moved."""
    return stamp_ns - sight.refused_ns >= settings.tracker_moved_s * NANOSECONDS


def _refuse(
    state: TwinState, sample: TrackerSample, residual: float, settings: TwinSettings
) -> Comparison:
    """A position that cannot be; if it stays, the tracker (or the robot, by hand) was moved: the origin follows."""
    if not stays(state.sight, sample.stamp_ns, settings):
        return state, [], []
    run = replace(state.run, origin=state.run.origin + residual)
    text = (
        f"the tracker's positions jumped by {1e3 * residual:+.0f} mm and stayed: its zero was moved"
    )
    notice = Notice(sample.stamp_ns, Severity.WARNING, text)
    return (
        state.but(run=run, sight=Sight(sample.stamp_ns, sample.rear_position)),
        [],
        [notice],
    )


def _watch_anchors(
    state: TwinState, cycle: Cycle, stamp_ns: int, residual: float, parameters: Parameters
) -> tuple[TwinState, list[Notice]]:
    anchors, text = observe_anchors(
        state.anchors, cycle, residual, parameters.pitch, state.run.direction
    )
    state = state.but(anchors=anchors)
    if text:
        state = state.but(monitor=forget(state.monitor, POSITION))
    state, notices = _warn(state, stamp_ns, cycle, text)
    state, more = _fit_phase(state, stamp_ns, parameters, happened=bool(text))
    return state, notices + more


def _fit_phase(
    state: TwinState, stamp_ns: int, parameters: Parameters, *, happened: bool
) -> tuple[TwinState, list[Notice]]:
    """Moves L0 when cycle after cycle gains another number of grooves than it should; see `worm_model.twin.phase`."""
    run = state.run
    if not happened or not tells_of_length(state.anchors) or run.length_seen or run.gait is None:
        return state, []
    gained = state.anchors.gained[-1]
    length = length_for(run.gait, parameters, gained)
    if length is None:
        return state, []
    text = (
        f"{CYCLES} cycles running gained {gained:+d} grooves more than predicted: L0 is taken as "
        f"{1e3 * length:.1f} mm instead of {1e3 * run.initial_length:.1f} mm"
    )
    run = replace(run, initial_length=length, length_fitted=True)
    anchors = replace(state.anchors, gained=())
    notice = Notice(stamp_ns, Severity.WARNING, text)
    return state.but(run=run, anchors=anchors, watch=PowerWatch(state.watch.cycle)), [notice]


def tells_of_length(anchors: Anchors) -> bool:
    """Whether cycle after cycle gained another number of grooves than it should, always the same."""
    last = anchors.gained[-CYCLES:]
    return len(last) == CYCLES and last[0] != 0 and len(set(last)) == 1
