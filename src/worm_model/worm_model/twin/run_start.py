# SPDX-License-Identifier: Apache-2.0
"""When a run begins, and from what."""

from __future__ import annotations

import math
from dataclasses import replace

from worm_model.gait import FORWARD, Gait
from worm_model.parameters import Parameters
from worm_model.simulation.closed_form import front_groove
from worm_model.simulation.simulator import Locomotion
from worm_model.twin.anchors import Anchors
from worm_model.twin.estimated_length import Actuation, engage, join
from worm_model.twin.hypotheses import PowerWatch
from worm_model.twin.pose import left_behind
from worm_model.twin.records import (
    NANOSECONDS,
    Activity,
    CommandedLength,
    GaitSample,
    LengthSource,
)
from worm_model.twin.residuals import start_monitor
from worm_model.twin.rest import rest_pose
from worm_model.twin.track import Knot, start_track
from worm_model.twin.twin_settings import TwinSettings
from worm_model.twin.twin_state import Pose, Run, TwinState

PLAYING = (Activity.RUNNING, Activity.STOPPING)
SAME_RUN_NS = 100_000_000  # the driver states the onset anew with each cycle, through two clocks
LATE_NS = 20_000_000  # an onset heard of later than this is worth a word
MOVED = 1e-6  # m, beyond which a command has left 0
PLAUSIBLE = 0.02  # m between a measured length at rest and the parameter's


def holding(state: TwinState) -> bool:
    """Whether the driver rests before a gait, so that an onset may come at any time."""
    return state.activity is Activity.RESTING


def is_new_run(state: TwinState, sample: GaitSample) -> bool:
    """Whether a gait state is the first word of a run."""
    if sample.activity not in PLAYING or sample.onset_ns <= 0:
        return False
    run = state.run
    return run.gait is None or abs(sample.onset_ns - run.start_ns) > SAME_RUN_NS


def begin_implied_run(state: TwinState, before: Actuation, sample: CommandedLength) -> bool:
    """Whether a command leaves 0 without any gait state having been heard."""
    unheard = state.activity is None and not before.engaged
    return unheard and sample.length_change < -MOVED


def run_goes_on(state: TwinState, sample: GaitSample) -> TwinState:
    """The state after a gait state that begins no run; it may end one."""
    if state.run.active and sample.activity not in PLAYING:
        return state.but(run=replace(state.run, end_ns=sample.stamp_ns))
    return state


def begin_run(
    state: TwinState,
    onset_ns: int,
    gait: Gait | None,
    parameters: Parameters,
    settings: TwinSettings,
) -> tuple[TwinState, str]:
    """(the state at the onset but for its track, what to tell): rest pose, fresh energy and anchors.

    An onset that the twin has passed already is heard of late, or the twin came late: it starts where it is,
    with the length that the gait would have by then.
    """
    run, text = _stand(state, onset_ns, gait, parameters, settings)
    effective = parameters.replace(initial_length=run.initial_length)
    passed = state.end_ns if state.track is not None or state.queued else state.streams.now_ns
    start = max(onset_ns, passed)
    late = start - onset_ns
    if late > 0 and gait is not None:
        actuation = join(gait, onset_ns, start, effective)
    else:
        actuation = engage(start, effective)
    begun = state.but(
        run=run,
        actuation=actuation,
        estimates=(),
        waiting=(),
        queued=(),
        track=None,
        observations=(),
        monitor=start_monitor(state.monitor, start),
        anchors=Anchors(),
        watch=PowerWatch(),
    )
    if late > LATE_NS:
        text += f"; its onset was {late / NANOSECONDS:.2f} s ago, the twin starts with its gait as commanded"
    return begun, text


def _stand(
    state: TwinState,
    onset_ns: int,
    gait: Gait | None,
    parameters: Parameters,
    settings: TwinSettings,
) -> tuple[Run, str]:
    """(the run with all that is known of the robot at rest before it, what to tell)."""
    before, seen = state.run, rest_pose(state.rest, onset_ns, settings.rest_s)
    direction = FORWARD if gait is None else gait.direction
    run = Run(onset_ns, gait, before.origin, parameters.initial_length)
    source = "from the parameters"
    if abs(seen.length - parameters.initial_length) <= PLAUSIBLE:  # False for NaN
        run = replace(run, initial_length=seen.length, length_seen=True)
        source = "as measured at rest"
    elif before.length_seen or before.length_fitted:
        run = replace(
            run,
            initial_length=before.initial_length,
            length_seen=before.length_seen,
            length_fitted=before.length_fitted,
        )
        source = "as in the run before"
    text = f"a run begins, L0 = {1e3 * run.initial_length:.2f} mm ({source})"
    effective = parameters.replace(initial_length=run.initial_length)
    pose = Pose(front_groove=front_groove(effective))
    earlier = parameters.replace(initial_length=before.initial_length)
    place = left_behind(state, earlier, run.initial_length, direction)
    if place is not None:
        if not math.isfinite(seen.position):
            return replace(run, origin=place.anchor, pose=place.pose), text
        if place.agrees_with(seen.position, parameters.pitch):
            return replace(run, origin=seen.position - place.pose.x1, pose=place.pose), text
        text += "; the robot was moved since the last run"
    origin = before.origin if math.isnan(seen.position) else seen.position
    return replace(run, origin=origin, pose=pose), text


def put_at_rest(state: TwinState, model: Locomotion, knot: Knot | None = None) -> TwinState:
    """The state with the twin at rest: where the run starts, or anew at a knot."""
    pose = state.run.pose
    if knot is None:
        actuation = state.actuation
        assert actuation is not None
        knot = Knot(
            actuation.stamp_ns, actuation.length_change, actuation.rate, LengthSource.ESTIMATED
        )
    motion = model.start(0.0, knot.length_change, pose.x1, pose.front_groove)
    track = start_track(knot, motion, model)
    return state.but(track=track, queued=(), published_ns=knot.stamp_ns)
