# SPDX-License-Identifier: Apache-2.0
"""The twin all at once against the twin sample by sample."""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from recorded_run import EPOCH, GAIT, INITIAL_LENGTH, REST_S, simulated_run
from same_replay import check_same

from worm_model.bags.lab_logs import LabSettings, read_lab_run
from worm_model.parameters import PAPER
from worm_model.run import GaitStates, LengthSamples, PowerSamples, Run, TrackerSamples
from worm_model.twin.by_sample import replay_samples
from worm_model.twin.hypotheses import PHASES, hypotheses
from worm_model.twin.offline.follow import replay_columns
from worm_model.twin.offline.sample_timeline import Irregular
from worm_model.twin.offline_replay import replay_run
from worm_model.twin.twin_settings import TwinSettings

RUN = simulated_run(cycles=3)
ONSET = EPOCH + round(REST_S * 1e9)
TIMES = st.floats(0.2, 6.0)  # s after the onset


def without(samples, chosen):
    """Samples but for the chosen ones."""
    return type(samples)(**{name: values[~chosen] for name, values in vars(samples).items()})


def blind(run: Run, start: float, end: float) -> Run:
    """No measured length between two times, s after the onset."""
    time = (run.measured.stamp - ONSET) * 1e-9
    return replace(run, measured=without(run.measured, (time > start) & (time < end)))


def doubled(run: Run) -> Run:
    """Every third measured length comes twice, the second one wrong."""
    stamp = np.sort(np.concatenate([run.measured.stamp, run.measured.stamp[::3]]))
    row = np.searchsorted(run.measured.stamp, stamp)
    again = np.concatenate([[False], np.diff(stamp) == 0])
    wrong = np.where(again, 0.01, 0.0)
    length = run.measured.length[row] + wrong
    return replace(
        run, measured=LengthSamples(stamp, length, run.measured.length_change[row] + wrong)
    )


def shifted(run: Run, distance: float, start: float) -> Run:
    """The robot slides by a distance at a time, s after the onset."""
    later = (run.tracker.stamp - ONSET) * 1e-9 > start
    tracker = replace(
        run.tracker,
        rear_position=run.tracker.rear_position + distance * later,
        front_position=run.tracker.front_position + distance * later,
    )
    return replace(run, tracker=tracker)


def told(run: Run, delay_ns: int) -> Run:
    """The driver tells of the run at another time than its onset."""
    stamp = run.gait_state.stamp.copy()
    stamp[1] += delay_ns
    return replace(run, gait_state=replace(run.gait_state, stamp=stamp))


def invalid_power(run: Run) -> Run:
    status = run.power.status.copy()
    status[100:140] = 3
    return replace(run, power=replace(run.power, status=status))


def silent(run: Run, start: float, end: float, *names: str) -> Run:
    """Nothing from some streams between two times, s after the onset."""
    kept = {}
    for name in names:
        samples = getattr(run, name)
        time = (samples.stamp - ONSET) * 1e-9
        kept[name] = without(samples, (time > start) & (time < end))
    return replace(run, **kept)


def told_as(run: Run, *states: tuple[float, int, float | None]) -> Run:
    """Other gait states: time and onset in s after the onset (None: not known), and what the driver does."""
    known = {name: np.full(len(states), v[-1]) for name, v in vars(run.gait_state).items()}
    known["stamp"] = np.array([ONSET + round(1e9 * time) for time, _, _ in states])
    known["state"] = np.array([state for _, state, _ in states])
    known["onset"] = np.array([0 if o is None else ONSET + round(1e9 * o) for _, _, o in states])
    return replace(run, gait_state=GaitStates(**known))


def absurd(run: Run) -> Run:
    """Numbers that no robot can have."""
    power, rear = run.power.power.copy(), run.tracker.rear_position.copy()
    power[[100, 200]], rear[[50, 60, 70]] = [1e300, -np.inf], [1e300, np.inf, -1e7]
    return replace(
        run,
        power=replace(run.power, power=power),
        tracker=replace(run.tracker, rear_position=rear),
    )


def unseen(run: Run, start: float, end: float) -> Run:
    """No tracker between two times, s after the onset."""
    time = (run.tracker.stamp - ONSET) * 1e-9
    return replace(run, tracker=without(run.tracker, (time > start) & (time < end)))


def wild(run: Run, times: list[float]) -> Run:
    """The tracker takes something else for the worm at some times, s after the onset."""
    rear = run.tracker.rear_position.copy()
    rear[np.searchsorted(run.tracker.stamp, [ONSET + round(1e9 * time) for time in times])] += 0.3
    return replace(run, tracker=replace(run.tracker, rear_position=rear))


def end_to_end(run: Run, other: Run, pause_s: float = 0.0, moved_m: float = 0.0) -> Run:
    """One run after the other, in one recording; the robot goes on from where it stands."""
    ends = [s.stamp[-1] for s in (run.commanded, run.measured, run.tracker, run.power)]
    later = int(max(ends)) + round(1e9 * (0.02 + pause_s)) - EPOCH
    shift = np.nanmean(run.tracker.rear_position[-5:]) + moved_m - other.tracker.rear_position[0]
    streams = {}
    for name in ("commanded", "measured", "tracker", "power", "gait_state"):
        one, two = getattr(run, name), getattr(other, name)
        columns = {}
        for column, values in vars(two).items():
            added = values + later * (values > 0) if column in ("stamp", "onset") else values
            added = added + shift if column.endswith("_position") else added
            columns[column] = np.concatenate([getattr(one, column), added])
        streams[name] = type(two)(**columns)
    return replace(run, **streams)


def reversed_gait(run: Run) -> Run:
    """The same, played backwards in space."""
    tracker = run.tracker
    mirrored = replace(
        tracker, rear_position=-tracker.front_position, front_position=-tracker.rear_position
    )
    states = replace(run.gait_state, direction=-run.gait_state.direction)
    return replace(run, tracker=mirrored, gait_state=states)


def one_marker(run: Run) -> Run:
    """Nobody sees the length."""
    hidden = np.full_like(run.tracker.front_position, np.nan)
    return replace(
        run, measured=LengthSamples(), tracker=replace(run.tracker, front_position=hidden)
    )


def unannounced(run: Run) -> Run:
    """Nobody tells of the gait."""
    return replace(run, gait_state=GaitStates())


def poor_power(run: Run, first: float, last: float) -> Run:
    """Power as of a robot that misses a groove, between two times, s after the onset."""
    pair = hypotheses(GAIT, PAPER.replace(initial_length=INITIAL_LENGTH))
    time = (run.power.stamp - ONSET) * 1e-9
    phase = np.minimum((time * GAIT.frequency % 1.0 * PHASES).astype(int), PHASES - 1)
    missing = np.where((time > first) & (time < last), np.array(pair.difference)[phase], 0.0)
    return replace(run, power=replace(run.power, power=run.power.power + 1.3 * missing))


LONG = simulated_run(cycles=9)

VARIANTS: dict[str, Callable[[], Run]] = {
    "as it is": lambda: RUN,
    "no measured length at all": lambda: replace(RUN, measured=LengthSamples()),
    "no measured length after the onset": lambda: blind(RUN, -0.01, 99.0),
    "a gap that the estimate bridges": lambda: blind(RUN, 1.0, 2.2),
    "a short gap": lambda: blind(RUN, 1.0, 1.15),
    "several gaps": lambda: blind(blind(blind(RUN, 0.5, 0.9), 3.0, 3.3), 6.0, 7.5),
    "a gap at the end": lambda: blind(RUN, 7.0, 99.0),
    "duplicates": lambda: doubled(RUN),
    "a missed groove": lambda: shifted(RUN, -PAPER.pitch, 3.2),
    "a missed groove in the last cycle": lambda: shifted(RUN, -PAPER.pitch, 6.0),
    "a missed groove while the tracker is away": lambda: unseen(
        shifted(RUN, -PAPER.pitch, 3.2), 2.8, 4.0
    ),
    "an extra groove": lambda: shifted(RUN, PAPER.pitch, 1.0),
    "a slip of no whole groove": lambda: shifted(RUN, 0.4 * PAPER.pitch, 1.0),
    "no power": lambda: replace(RUN, power=PowerSamples()),
    "power without readings": lambda: invalid_power(RUN),
    "told of before the onset": lambda: told(RUN, -30_000_000),
    "told of after the onset": lambda: told(RUN, 30_000_000),
    "told of long before the onset": lambda: told(RUN, -200_000_000),
    "heard of late": lambda: told(RUN, 200_000_000),
    "heard of much later": lambda: told(RUN, 1_700_000_000),
    "neither command nor length for a while": lambda: silent(
        RUN, 2.0, 2.7, "commanded", "measured"
    ),
    "no command for a while": lambda: silent(RUN, 2.0, 2.9, "commanded"),
    "the recorder starts in mid-run": lambda: told_as(
        silent(RUN, -9.0, 2.9, "commanded", "measured", "tracker", "power"), (2.5, 3, 0.0)
    ),
    "no length before the onset": lambda: silent(RUN, -9.0, 0.0, "commanded", "measured"),
    "absurd numbers": lambda: absurd(RUN),
    "a stop in between": lambda: told_as(
        RUN, (-1.4, 2, None), (0.0, 3, 0.0), (2.0, 4, 0.0), (2.4, 5, 0.0), (4.0, 2, None)
    ),
    "other noise": lambda: simulated_run(cycles=2, seed=7),
    "no tracker": lambda: replace(RUN, tracker=TrackerSamples()),
    "a tracker that is away for long": lambda: unseen(RUN, 3.0, 5.2),
    "a tracker that goes away": lambda: unseen(RUN, 5.0, 99.0),
    "a missed groove while the tracker is away for long": lambda: unseen(
        shifted(RUN, -PAPER.pitch, 2.0), 2.3, 4.9
    ),
    "a marker taken for another": lambda: wild(RUN, [2.0, 2.1, 4.0]),
    "no command": lambda: replace(RUN, commanded=LengthSamples()),
    "nobody tells of the gait": lambda: unannounced(RUN),
    "nobody tells of the first of two gaits": lambda: end_to_end(unannounced(RUN), RUN),
    "two runs": lambda: end_to_end(RUN, simulated_run(cycles=2, seed=3)),
    "forward and back": lambda: end_to_end(RUN, reversed_gait(RUN)),
    "a second run without an end of the first": lambda: end_to_end(
        replace(RUN, gait_state=without(RUN.gait_state, RUN.gait_state.state == 1)), RUN, 0.3
    ),
    "a second run after a missed groove": lambda: end_to_end(shifted(RUN, -PAPER.pitch, 6.0), RUN),
    "the robot is moved between two runs": lambda: end_to_end(RUN, RUN, moved_m=0.4 * PAPER.pitch),
    "many missed grooves": lambda: shifted(
        shifted(shifted(LONG, -PAPER.pitch, 3.2), -PAPER.pitch, 8.0), -PAPER.pitch, 10.7
    ),
    "power of missed grooves": lambda: poor_power(LONG, 12.5, 15.0),
    "power of missed grooves at the end of it": lambda: replace(
        (late := poor_power(LONG, 12.5, 15.0)),
        power=without(late.power, (late.power.stamp - ONSET) * 1e-9 > 15.05),
    ),
}


@pytest.mark.parametrize("variant", VARIANTS)
def test_both_agree(variant: str):
    check_same(VARIANTS[variant](), PAPER)


@pytest.mark.parametrize(
    "changes",
    [{"gain": 0.7, "slack": 0.002}, {"front_mass": 0.9, "time_constant": 0.4}, {"pitch": 0.02}],
)
def test_both_agree_on_other_robots(changes: dict[str, float]):
    check_same(RUN, PAPER.replace(**changes))


@pytest.mark.parametrize(
    "changes",
    [
        {"output_period_s": 0.1, "start_hold_s": 0.0},
        {"output_period_s": 0.0, "measured_stale_s": 0.02},
        {"smoothing_s": 0.05, "rest_s": 0.3},
        {"smoothing_s": 0.6, "position_scale_m": 2e-4, "power_scale_W": 0.05},
        {"tracker_gate_m": 0.005},
    ],
)
def test_both_agree_whatever_the_settings(changes: dict[str, float]):
    run = wild(shifted(end_to_end(RUN, RUN), -PAPER.pitch, 3.2), [2.0])
    check_same(run, PAPER, TwinSettings(**changes))


@pytest.mark.parametrize("number", range(1, 9))
def test_both_agree_on_the_campaign(shared: Path, number: int):
    folder = shared / "campaign" / f"run_{number:02}"
    check_same(read_lab_run(folder, LabSettings(epoch=EPOCH)).run, PAPER)


def test_the_variants_are_what_they_say():
    """Or they would agree on nothing happening."""
    texts = {
        name: [notice.text for notice in replay_columns(VARIANTS[name](), PAPER).notices]
        for name in (
            "many missed grooves",
            "power of missed grooves",
            "power of missed grooves at the end of it",
            "two runs",
            "the robot is moved between two runs",
            "a missed groove while the tracker is away for long",
            "heard of much later",
        )
    }
    assert sum("missed a groove" in text for text in texts["many missed grooves"]) == 3
    for name in ("power of missed grooves", "power of missed grooves at the end of it"):
        assert any("its power is that of a missed groove" in text for text in texts[name])
    assert sum("a run begins" in text for text in texts["two runs"]) == 2
    assert any("was moved" in text for text in texts["the robot is moved between two runs"])
    gone = texts["a missed groove while the tracker is away for long"]
    assert any("missed a groove" in text for text in gone)
    assert any("its onset was" in text for text in texts["heard of much later"])


IRREGULAR: dict[str, Callable[[], Run]] = {
    "a tracker that is moved": lambda: shifted(RUN, 0.2, 3.0),
    "a pause of everything": lambda: end_to_end(RUN, RUN, 2.0),
    "neither command nor length for long": lambda: replace(
        blind(RUN, 2.0, 5.0),
        commanded=without(
            RUN.commanded, np.abs(RUN.commanded.stamp - ONSET - 35 * 10**8) < 15 * 10**8
        ),
    ),
    "a power that nothing is remembered for": lambda: silent(
        RUN, 2.0, 2.9, "commanded", "measured"
    ),
    "a length that no command is remembered for": lambda: silent(RUN, 2.0, 3.4, "commanded"),
    "a run that is over before it begins": lambda: told_as(
        RUN, (-1.4, 2, None), (-0.03, 3, 0.0), (-0.01, 4, 0.0), (-0.005, 5, 0.0)
    ),
    "a run that begins before the one before it": lambda: told_as(
        RUN, (-1.4, 2, None), (0.0, 3, 0.9), (0.02, 3, 0.0)
    ),
    "grooves that tell of the length": lambda: shifted(
        shifted(one_marker(LONG), -PAPER.pitch, 3.2), -PAPER.pitch, 5.7
    ),
}


@pytest.mark.parametrize("variant", IRREGULAR)
def test_irregular_recordings_are_left_to_the_samples(variant: str):
    run = IRREGULAR[variant]()
    with pytest.raises(Irregular):
        replay_columns(run, PAPER)
    one, other = replay_run(run, PAPER), replay_samples(run, PAPER)
    assert one.notices == other.notices
    np.testing.assert_array_equal(one.states["stamp_ns"], other.states["stamp_ns"])


def test_the_run_of_these_tests_gains_grooves():
    assert replay_columns(RUN, PAPER).states["rear_groove"][-1] >= 3
    assert (RUN.measured.stamp[-1] - ONSET) * 1e-9 > 3 * GAIT.period


@st.composite
def recordings(draw: st.DrawFn) -> Run:
    """Runs with dropped samples, jittered stamps, slips, occlusions, one or two of them, told of in time or not."""
    run = simulated_run(cycles=draw(st.integers(1, 3)), seed=draw(st.integers(0, 9)))
    if draw(st.booleans()):
        run = shifted(run, draw(st.sampled_from([-1.0, 0.3, 1.0])) * PAPER.pitch, draw(TIMES))
    if draw(st.booleans()):
        run = told(run, draw(st.integers(-300, 300)) * 1_000_000)
    if draw(st.booleans()):
        run = unseen(run, start := draw(TIMES), start + draw(TIMES))
    if draw(st.booleans()):
        run = end_to_end(run, simulated_run(cycles=1), draw(st.sampled_from([0.0, 0.5])))
    for name in draw(st.sets(st.sampled_from(["commanded", "measured", "tracker", "power"]))):
        start, length = draw(st.floats(-1.5, 6.0)), draw(st.sampled_from([0.1, 0.5, 0.95, 2.0]))
        run = silent(run, start, start + length, name)
    seed = np.random.default_rng(draw(st.integers(0, 99)))
    kept, jitter_ns = draw(st.sampled_from([1.0, 0.9, 0.5])), draw(st.sampled_from([0, 2_000_000]))
    streams = {}
    for name in ("commanded", "measured", "tracker", "power"):
        samples = getattr(run, name)
        thinned = without(samples, seed.random(samples.stamp.size) > kept)
        moved = thinned.stamp + seed.integers(0, jitter_ns + 1, thinned.stamp.size)
        streams[name] = replace(thinned, stamp=moved)
    return replace(run, **streams)


@settings(max_examples=30, deadline=None)
@given(recordings())
def test_both_agree_on_any_recording(run: Run):
    with suppress(Irregular):
        check_same(run, PAPER)
