# SPDX-License-Identifier: Apache-2.0
"""The twin's core, compared with the simulator, and with every kind of bad sample."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from random_cases import examples
from twin_samples import (
    ONSET,
    CommandedLength,
    GaitSample,
    MeasuredLength,
    PowerSample,
    TrackerSample,
    TwinOutput,
    at,
    follow,
)

from worm_model.gait import REVERSE, Gait
from worm_model.parameters import PAPER
from worm_model.run import Activity, LengthSource
from worm_model.simulation.simulator import simulate
from worm_model.twin.cause_table import GAP
from worm_model.twin.data.records import Health
from worm_model.twin.twin import Twin

GAIT = Gait(0.07, 0.2)
FAR = Gait(0.08, 0.2)  # far from the edges of the grooves per cycle
IDLE = Activity.IDLE
ORIGIN = 0.4  # m, tracked position of the rear module at the start


def commands(gait: Gait, end: float, rate: float = 100.0, rest: float = 2.0) -> list:
    times = np.arange(-round(rest * rate), round(end * rate) + 1) / rate
    return [CommandedLength(at(t), gait.command(t) if t > 0 else 0.0) for t in times]


def announcements(gait: Gait) -> list:
    return [
        GaitSample(at(-1.5), Activity.RESTING, gait),
        GaitSample(at(0.0), Activity.RUNNING, gait, ONSET),
    ]


def observed(gait: Gait, end: float, rate: float = 30.0, rest: float = 2.0) -> list:
    """Return the samples of a perfect camera and power sensor."""
    cycles = math.ceil(end * gait.frequency) + 1
    times = np.arange(-round(rest * rate), round(end * rate) + 1) / rate
    seen = simulate(gait, cycles=cycles).at(np.maximum(times, 0.0))
    samples = []
    for time, x1, length, power in zip(times, seen.x1, seen.length, seen.power, strict=True):
        samples.append(TrackerSample(at(time), ORIGIN + x1, ORIGIN + x1 + length))
        samples.append(MeasuredLength(at(time), length))
        samples.append(PowerSample(at(time), power if time > 0 else PAPER.idle_power))
    return samples


def in_order(*streams: list) -> list:
    return sorted((sample for stream in streams for sample in stream), key=lambda s: s.stamp_ns)


def texts(output: TwinOutput) -> str:
    return "\n".join(notice.text for notice in output.notices)


@pytest.mark.parametrize("gait", [GAIT, Gait(0.05, 0.25), Gait(0.07, 0.2, REVERSE)])
def test_estimated_length_reproduces_the_simulator(gait):
    end = 5 / gait.frequency
    last = follow(in_order(announcements(gait), commands(gait, end))).states[-1]
    exact = simulate(gait).at([end])
    assert last.stamp_ns == at(end)
    assert last.length_source == LengthSource.ESTIMATED
    assert last.rear_position == pytest.approx(exact.x1[0], abs=1e-6)
    assert last.front_position == pytest.approx(exact.x2[0], abs=1e-6)
    assert last.rear_groove == exact.rear_groove[0]
    assert last.cable_force == pytest.approx(exact.cable_force[0], abs=0.1)
    assert last.energy == pytest.approx(exact.energy[0], rel=1e-3)


def test_measured_length_reproduces_the_simulator_in_the_trackers_frame():
    output = follow(in_order(announcements(GAIT), commands(GAIT, 25.0), observed(GAIT, 25.0)))
    last = output.states[-1]
    exact = simulate(GAIT).at([25.0])
    assert last.length_source == LengthSource.MEASURED
    assert last.initial_length == pytest.approx(PAPER.initial_length, abs=1e-9)
    assert last.rear_position == pytest.approx(ORIGIN + exact.x1[0], abs=1e-5)
    assert last.energy == pytest.approx(exact.energy[0], rel=0.01)
    inside = [r for r in output.residuals if r.stamp_ns > at(0)]
    assert max(abs(r.rear_position) for r in inside if not math.isnan(r.rear_position)) < 1e-3
    assert max(abs(r.length) for r in inside if not math.isnan(r.length)) < 1e-5
    assert {r.health for r in inside} == {Health.HEALTHY}


def full_run(end: float = 6.0) -> list:
    return in_order(announcements(GAIT), commands(GAIT, end), observed(GAIT, end))


@examples(12)
@given(seed=st.integers(0, 2**32 - 1), chunk=st.sampled_from([1, 7, 100]))
def test_neither_calls_nor_the_order_within_the_delay_matter_to_the_bit(seed, chunk):
    """Every sample is late by a different time within the delay."""
    samples = full_run(4.0)
    delays = np.random.default_rng(seed).uniform(0.0, 0.249e9, len(samples))
    stamps = np.array([s.stamp_ns - ONSET for s in samples])
    shuffled = [samples[k] for k in np.argsort(stamps + delays)]
    assert repr(follow(shuffled, chunk=chunk)) == repr(follow(samples))


BAD = {
    "duplicate": CommandedLength(at(1.0), -0.5),
    "late": CommandedLength(at(0.744), -0.5),
    "nan": CommandedLength(at(1.001), math.nan),
    "infinite": CommandedLength(at(1.001), -math.inf),
    "in millimetres": CommandedLength(at(1.001), -70.0),
    "without a stamp": CommandedLength(0, -0.5),
    "huge power": PowerSample(at(1.001), 1e300),
    "infinite power": PowerSample(at(1.001), -math.inf),
    "huge position": TrackerSample(at(1.001), 1e300, 0.7),
    "infinite position": TrackerSample(at(1.001), math.inf, math.nan),
}


@pytest.mark.parametrize("bad", BAD.values(), ids=BAD)
def test_a_bad_sample_leaves_no_trace(bad):
    clean = in_order(announcements(GAIT), commands(GAIT, 2.0), observed(GAIT, 2.0))
    place = 1 + next(
        k for k, s in enumerate(clean) if s == CommandedLength(at(1.0), GAIT.command(1.0))
    )
    assert repr(follow([*clean[:place], bad, *clean[place:]])) == repr(follow(clean))


def test_stale_measurements_hand_over_to_the_command_and_back():
    kept = [
        s
        for s in observed(GAIT, 8.0)
        if not (isinstance(s, MeasuredLength) and at(3.0) < s.stamp_ns < at(5.0))
    ]
    states = follow(in_order(announcements(GAIT), commands(GAIT, 8.0), kept)).states

    def sources(first, last):
        return {s.length_source for s in states if at(first) < s.stamp_ns < at(last)}

    assert sources(1.0, 2.9) == {LengthSource.MEASURED}
    assert sources(3.3, 4.9) == {LengthSource.ESTIMATED}
    assert sources(5.3, 8.0) == {LengthSource.MEASURED}
    exact = simulate(GAIT).at([states[-1].stamp_ns * 1e-9 - ONSET * 1e-9])
    assert states[-1].rear_position == pytest.approx(ORIGIN + exact.x1[0], abs=1e-4)


@pytest.mark.parametrize("one_by_one", [True, False])
def test_a_pause_of_a_measured_length_is_survived(one_by_one: bool):
    samples = in_order(announcements(GAIT), commands(GAIT, 3.0), observed(GAIT, 8.0))
    kept = [s for s in samples if not at(3.0) < s.stamp_ns < at(5.0)]
    output = follow(kept, chunk=1 if one_by_one else 0)
    assert "no length for 2.0" in texts(output)
    assert output.states[-1].stamp_ns > at(7.9)
    energy = [s.energy for s in output.states]
    assert all(math.isfinite(e) for e in energy)


@pytest.mark.parametrize(("command", "length"), [(3.9, 4.04), (4.04, 3.9)])
def test_a_pause_ends_at_the_next_length_of_any_kind(command: float, length: float):
    """Between two lengths of any kind are 0.9 s at most, less than `PAUSE_NS`."""
    kept = [s for s in commands(GAIT, 6.0) if not at(3.0) < s.stamp_ns < at(command)]
    seen = [TrackerSample(at(3.85), ORIGIN, math.nan), MeasuredLength(at(length), 0.27)]
    output = follow(in_order(announcements(GAIT), kept, seen))
    assert GAP.code not in {notice.code for notice in output.notices}


WILD = {
    "command": lambda t: CommandedLength(at(t), -0.01),
    "length": lambda t: MeasuredLength(at(t), 0.29),
    "tracker": lambda t: TrackerSample(at(t), 0.4, 0.7),
    "power": lambda t: PowerSample(at(t), 2.0),
    "gait": lambda t: GaitSample(at(t), Activity.IDLE),
}


@pytest.mark.parametrize(
    "ahead",
    [
        [("command", 2.0), ("tracker", 30.0), ("power", 59.0)],
        [("power", 59.0), ("tracker", 30.0), ("command", 2.0)],
        [("command", 2.0), ("tracker", 2.01), ("power", 59.0)],
        [("command", 2.0), ("command", 2.01), ("gait", 2.02)],
        [("gait", 2.0), ("tracker", 2.01), ("tracker", 2.02)],
        [("gait", 2.0), ("gait", 2.01), ("gait", 2.02)],
        *([(kind, t), (kind, t + 0.01)] for kind in WILD for t in (5.0, 998.0)),
        [("tracker", 998.0 + k / 30.0) for k in range(50)],  # the camera's clock is wrong
        *([(kind, -1002.0)] * 2 for kind in WILD if kind != "gait"),  # a latched state has any age
    ],
)
def test_wild_stamps_that_do_not_confirm_each_other_leave_no_trace(ahead):
    """Some stamps disagree, or those of a single topic agree; a driver state confirms nothing."""
    clean = in_order(announcements(GAIT), commands(GAIT, 4.0), observed(GAIT, 4.0))
    place = next(k for k, s in enumerate(clean) if s.stamp_ns > at(2.0))
    wild = [WILD[kind](2.0 + time) for kind, time in ahead]
    spoilt = follow([*clean[:place], *wild, *clean[place:]])
    assert repr(spoilt) == repr(follow(clean))


def test_driver_states_during_a_pause_are_accepted_once():
    """The driver reports the onset and each cycle, while all lengths are lost."""
    states = [
        GaitSample(at(k * GAIT.period), Activity.RUNNING, GAIT, ONSET, run=1, cycle=k + 1)
        for k in range(5)
    ]
    kept = [s for s in commands(GAIT, 30.0) if not at(-1.5) < s.stamp_ns < at(21.0)]
    samples = in_order(states, kept)
    twin = Twin()
    state = twin.start()
    output = follow(samples, twin, state=state)
    assert {name: n for name, n in state.counts.items() if n} == {"taken": len(samples)}
    assert texts(output).count("a run begins") == 1
    assert output.states[-1].stamp_ns == at(30.0)


@pytest.mark.parametrize(("rate", "number"), [(1.0, 3), (30.0, 100)])
def test_a_single_topic_goes_on_after_a_pause(rate: float, number: int):
    """Three samples suffice if no other topic was active before the pause, otherwise 100."""
    before = commands(GAIT, 0.0)
    if number == 100:
        before = in_order(before, observed(GAIT, 0.0))
    after = [CommandedLength(at(5.0 + k / rate), 0.0) for k in range(number)]
    output, early = follow([*before, *after]), follow([*before, *after[:-1]])
    assert output.states[-1].stamp_ns == after[-1].stamp_ns
    assert early.states[-1].stamp_ns == at(0.0)


def slipped(samples: list, time: float, offset: float, lasts: float = 1.0) -> list:
    """Move the robot on by an offset (m), from a time on within some seconds."""

    def moved(s: TrackerSample) -> TrackerSample:
        by = offset * min(max((s.stamp_ns - at(time)) * 1e-9 / lasts, 0.0), 1.0)
        return replace(s, rear_position=s.rear_position + by, front_position=s.front_position + by)

    return [moved(s) if isinstance(s, TrackerSample) else s for s in samples]


@pytest.mark.parametrize("gait", [GAIT, Gait(0.08, 0.4)])
@pytest.mark.parametrize("channel", ["position", "power"])
@pytest.mark.parametrize("size", [0.8, 1.8, 6.0])
def test_health_does_not_flicker_with_what_comes_and_goes_in_each_cycle(gait, channel, size):
    """The residual is a multiple of the usual one in the middle of each cycle, and 0 at its ends."""
    end = 5 * gait.period

    def spoilt(s):
        swell = 3.0 * size * math.sin(math.pi * (s.stamp_ns - ONSET) * 1e-9 / gait.period) ** 4
        if s.stamp_ns < ONSET:
            return s
        if isinstance(s, TrackerSample) and channel == "position":
            return replace(s, rear_position=s.rear_position + 0.003 * swell)
        if isinstance(s, PowerSample) and channel == "power":
            return replace(s, power=s.power + 0.6 * swell)
        return s

    seen = [spoilt(s) for s in observed(gait, end)]
    output = follow(in_order(announcements(gait), commands(gait, end), seen))
    health = [r.health for r in output.residuals if r.stamp_ns > ONSET]
    # each makes the health suspect for a cycle
    reports = sum(bool(notice.code) for notice in output.notices)
    assert np.count_nonzero(np.diff(health)) <= 2 * (1 + reports)


@pytest.mark.parametrize(("grooves", "word"), [(-1, "missed"), (1, "gained")])
def test_a_missed_or_extra_groove_is_reported_within_a_cycle_and_followed(grooves, word):
    seen = slipped(observed(FAR, 19.0), 11.0, grooves * PAPER.pitch)
    output = follow(in_order(announcements(FAR), commands(FAR, 19.0), seen))
    (notice,) = [n for n in output.notices if "cycle 3" in n.text]
    assert word in notice.text
    assert notice.stamp_ns <= at(15.1)  # it happened in the third cycle, 10 to 15 s
    suspect = [r for r in output.residuals if at(15.1) < r.stamp_ns < at(16)]
    assert all(r.health == Health.SUSPECT and word in r.message for r in suspect)
    slipping = [r.health for r in output.residuals if at(12.0) < r.stamp_ns < at(15.0)]
    assert Health.FAULTY in slipping
    after = [r.rear_position for r in output.residuals if r.stamp_ns > at(15.3)]
    assert np.nanmax(np.abs(after)) < 1e-3
    expected = simulate(FAR).at([19.0])
    assert output.states[-1].rear_groove == expected.rear_groove[0] + grooves
    assert "cycle 4" not in texts(output)


def arrived(samples: list, camera_s: float) -> list:
    """Return the samples in order of arrival: the camera's are later than the others by a time."""
    slow = MeasuredLength | TrackerSample
    delay = round(camera_s * 1e9)
    return sorted(samples, key=lambda s: s.stamp_ns + (delay if isinstance(s, slow) else 0))


def with_end(samples: list, gait: Gait, end: float) -> list:
    """Return the samples of a run that ends, with the command at rest and the driver idle for 3 s afterwards."""
    after = [CommandedLength(at(end + k / 100), 0.0) for k in range(1, 301)]
    return in_order(announcements(gait), samples, after, [GaitSample(at(end + 0.003), IDLE)])


@pytest.mark.parametrize(
    ("camera_s", "offset_ms", "end"), [(0.0, 0, 18), (0.03, 12, 18), (0.15, 33, 18), (0.0, 0, 15)]
)
def test_a_miss_in_the_last_cycle_is_reported(camera_s, offset_ms, end):
    """Also by a tracker that ends with it: the cycle is closed when its time has passed."""
    shift = offset_ms * 1_000_000
    seen = [
        replace(s, stamp_ns=s.stamp_ns + shift)
        for s in slipped(observed(GAIT, 17.0), 11.0, -PAPER.pitch)
        if s.stamp_ns < at(end)
    ]
    samples = with_end(commands(GAIT, 15.0) + seen, GAIT, 15.0)
    output = follow(arrived(samples, camera_s))
    (notice,) = [n for n in output.notices if "cycle" in n.text]
    assert "cycle 3: the robot missed a groove" in notice.text
    assert notice.stamp_ns <= at(15.1)
    after = [r.rear_position for r in output.residuals if r.stamp_ns > at(15.4)]
    assert end == 15 or np.nanmax(np.abs(after)) < 1.5e-3


@pytest.mark.parametrize(("end", "slip"), [(15.0, 22.0), (14.6, 11.0)])
def test_neither_the_rest_after_a_run_nor_a_cycle_that_was_stopped_is_judged(end, slip):
    seen = slipped(observed(GAIT, slip + 6.0), slip, -PAPER.pitch)
    output = follow(with_end(commands(GAIT, end) + seen, GAIT, end))
    assert "cycle" not in texts(output)


def test_a_short_jump_of_the_tracker_is_rejected():
    seen = [
        replace(s, rear_position=s.rear_position + 0.2)
        if isinstance(s, TrackerSample) and at(3.0) < s.stamp_ns < at(3.3)
        else s
        for s in observed(GAIT, 5.0)
    ]
    output = follow(in_order(announcements(GAIT), commands(GAIT, 5.0), seen))
    inside = [r.rear_position for r in output.residuals if r.stamp_ns > at(0)]
    assert np.nanmax(np.abs(inside)) < 1e-3
    assert {r.health for r in output.residuals if r.stamp_ns > at(0)} == {Health.HEALTHY}


def test_hidden_markers_and_missing_power_give_no_residual():
    seen = [
        replace(s, rear_position=math.nan, front_position=math.nan)
        if isinstance(s, TrackerSample)
        else replace(s, power=math.nan)
        if isinstance(s, PowerSample)
        else s
        for s in observed(GAIT, 3.0)
    ]
    output = follow(in_order(announcements(GAIT), commands(GAIT, 3.0), seen))
    assert all(math.isnan(r.rear_position) and math.isnan(r.power) for r in output.residuals)
    assert all(math.isfinite(s.rear_position) for s in output.states)


def test_without_any_gait_state_a_run_begins_with_the_command():
    last = follow(commands(GAIT, 25.0)).states[-1]
    exact = simulate(GAIT).at([25.0])
    assert last.rear_position == pytest.approx(exact.x1[0], abs=1e-6)


def test_before_a_run_the_twin_stands_still_and_reports_it():
    output = follow(in_order(commands(GAIT, 0.0), observed(GAIT, 0.0)))
    assert output.states[0].length_rate == 0.0
    assert all(math.isfinite(state.power) for state in output.states)
    last = output.states[-1]
    elapsed = (last.stamp_ns - output.states[0].stamp_ns) * 1e-9
    assert last.energy == pytest.approx(PAPER.idle_power * elapsed, rel=1e-3)


def test_parameters_may_change_during_a_run():
    samples = in_order(announcements(GAIT), commands(GAIT, 10.0))
    half = len(samples) // 2
    before, after = Twin(), Twin(PAPER.replace(power_factor=6.44))
    state = before.start()
    first = follow(samples[:half], before, state=state, end=False)
    second = follow(samples[half:], after, state=state)
    unchanged = follow(samples)
    assert first.states[-1].energy < second.states[-1].energy
    assert second.states[-1].energy > unchanged.states[-1].energy
    assert second.states[-1].rear_position == unchanged.states[-1].rear_position
