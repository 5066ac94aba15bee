# SPDX-License-Identifier: Apache-2.0
"""A whole recording through the twin at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from worm_model.parameters import Parameters
from worm_model.run import Run
from worm_model.twin.by_sample import Replay, Series
from worm_model.twin.core import Twin
from worm_model.twin.offline.beginnings import Beginning, Stretch, cut
from worm_model.twin.offline.sample_timeline import Kind, Timeline, read_timeline
from worm_model.twin.offline.stretch import follow_stretch, samples_in
from worm_model.twin.records import (
    NANOSECONDS,
    CommandedLength,
    GaitSample,
    MeasuredLength,
    Notice,
    Severity,
    TrackerSample,
)
from worm_model.twin.rest import GUARD_NS, observe_rest
from worm_model.twin.run_start import begin_run, put_at_rest
from worm_model.twin.streams import Streams
from worm_model.twin.twin_settings import DEFAULTS, TwinSettings
from worm_model.twin.twin_state import TwinState


def replay_columns(run: Run, parameters: Parameters, settings: TwinSettings = DEFAULTS) -> Replay:
    """What `worm_model.twin.core.Twin.step` yields for the samples of a recording, to rounding.

    Raises:
        Irregular: something happens that only samples one by one can tell.
        SimulationError: chatter.
    """
    twin = Twin(parameters, settings)
    timeline = read_timeline(run, settings)
    stretches = cut(timeline, settings)
    state = twin.start()
    parts: list[Replay | Notice] = []
    for number, stretch in enumerate(stretches):
        if stretch.begins is not None:
            state, notice = _begin(state, stretch.begins, stretch.end_ns, twin)
            parts.append(notice)
        following = stretches[number + 1].begins if number + 1 < len(stretches) else None
        next_ns = 0 if following is None else following.heard_ns
        state, output = follow_stretch(state, samples_in(timeline, stretch, next_ns), twin)
        parts.append(output)
        if following is not None:
            state = _rest_before(state, timeline, stretch, following, settings)
    return _join(parts)


def _begin(
    state: TwinState, begins: Beginning, end_ns: int, twin: Twin
) -> tuple[TwinState, Notice]:
    """(the state at a run's start, what to tell)."""
    state, text = begin_run(state, begins.onset_ns, begins.gait, twin.parameters, twin.settings)
    state = put_at_rest(state, twin.locomotion(state))
    state = state.but(run=replace(state.run, end_ns=end_ns))
    # The driver's word is told at its own time, a command's at that of the one before.
    stamp = begins.onset_ns if begins.gait is None else begins.heard_ns
    return state, Notice(stamp, Severity.INFO, text)


def _rest_before(
    state: TwinState,
    timeline: Timeline,
    stretch: Stretch,
    following: Beginning,
    settings: TwinSettings,
) -> TwinState:
    """The state with what a run that follows needs: the instruments at rest before it, and the newest stamps."""
    first = stretch.first if stretch.begins is None else max(stretch.first, stretch.end)
    since = following.onset_ns - round(settings.rest_s * NANOSECONDS) - 2 * GUARD_NS
    first += int(np.searchsorted(timeline.stamp[first : stretch.last], since))
    span = slice(first, stretch.last)
    rows = zip(
        timeline.stamp[span].tolist(),
        timeline.kind[span].tolist(),
        timeline.value[span].tolist(),
        timeline.front[span].tolist(),
        strict=True,
    )
    rest = state.rest
    for stamp, kind, value, front in rows:
        if kind == Kind.LENGTH:
            rest = observe_rest(rest, MeasuredLength(stamp, value), settings.rest_s)
        elif kind == Kind.POSITION:
            rest = observe_rest(rest, TrackerSample(stamp, value, front), settings.rest_s)
    last = int(timeline.stamp[stretch.last - 1]) if stretch.last else 0
    newest = {GaitSample: following.heard_ns, CommandedLength: last}
    return state.but(rest=rest, streams=Streams(newest, present_ns=last))


def _join(parts: Sequence[Replay | Notice]) -> Replay:
    replays = [part for part in parts if isinstance(part, Replay)]
    told = [(part,) if isinstance(part, Notice) else part.notices for part in parts]
    return Replay(
        states=_columns([replay.states for replay in replays]),
        residuals=_columns([replay.residuals for replay in replays]),
        messages=tuple(message for replay in replays for message in replay.messages),
        lengths=_columns([replay.lengths for replay in replays]),
        notices=tuple(notice for notices in told for notice in notices),
    )


def _columns(parts: Sequence[Series]) -> Series:
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
