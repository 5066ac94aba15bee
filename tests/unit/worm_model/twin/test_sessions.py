# SPDX-License-Identifier: Apache-2.0
"""Consecutive gaits of one robot: the live twin, and the replay of each recording with and without its memory."""

from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from driver_rig import settings as driver_settings
from recorded_run import write_bag
from virtual_session import Live, Played, Session, live_twin, recording, virtual_settings

from worm_driver.virtual_robot.plant import Grooves
from worm_driver.virtual_robot.virtual_robot import VirtualRobot
from worm_model.analysis.replay_metrics import RunReport, report_replay
from worm_model.bags.opening import open_bag
from worm_model.bags.run_reader import read_run
from worm_model.bags.worm_topics import REPLAY_INPUTS
from worm_model.commands import bags
from worm_model.gait import REVERSE, Gait, Profile
from worm_model.parameters import PAPER
from worm_model.twin.data.records import Health, Severity
from worm_model.twin.offline_replay import Replay, replay_run

FORWARD_GAIT, LONG = Gait(0.07, 0.25), Gait(0.08, 0.3)
BACKWARD = Gait(0.07, 0.25, REVERSE)
SECOND = 10**9


@dataclass(frozen=True)
class Seen:
    """A session: its samples, its gaits, and the output of the live twin."""

    rows: np.ndarray
    played: list[Played]
    live: Live


def seen(session: Session) -> Seen:
    rows = session.rows
    return Seen(rows, session.played, live_twin(rows))


def grooves_of(states: np.ndarray, played: Played) -> tuple[int, ...]:
    """Return the grooves of the rear anchor in each complete cycle, from the twin's states at the borders of cycles."""
    borders = [
        played.onset_ns + round(k * played.gait.period * SECOND)
        for k in range(len(played.grooves) + 1)
    ]
    rows = np.searchsorted(states["stamp_ns"], borders)
    return tuple(int(b - a) for a, b in pairwise(states["rear_groove"][rows]))


def replayed(session: Seen, played: Played, *, memory: bool = True) -> tuple[Replay, RunReport]:
    memories = session.live.memories if memory else ()
    run = recording(session.rows, memories, played.begin_ns, played.end_ns)
    replay = replay_run(run, PAPER)
    (report,) = report_replay(run, replay, PAPER.pitch).runs
    return replay, of_causes(report)


def of_causes(report: RunReport) -> RunReport:
    """Return a report without the events for information: most of these gaits are near an edge."""
    events = tuple(each for each in report.events if each[1].severity > Severity.INFO)
    return replace(report, events=events)


def live_health(session: Seen, played: Played) -> Health:
    rows = session.live.residuals
    inside = (rows["stamp_ns"] >= played.onset_ns) & (
        rows["stamp_ns"] <= played.end_ns - 2 * SECOND
    )
    return Health(int(rows["health"][inside].max(initial=0)))


# --- disturbances -------------------------------------------------------------------------------


def miss(robot: VirtualRobot, time: float) -> None:
    """Let the rear fins hold on to their groove in the fourth cycle."""
    stuck = 3 * FORWARD_GAIT.period < time < 3.8 * FORWARD_GAIT.period
    grooves = Grooves((1.0,) * 512, (1.0,) * 512) if stuck else usual_grooves()
    robot.plant = replace(robot.plant, rear_grooves=grooves)


@lru_cache
def usual_grooves() -> Grooves:
    return VirtualRobot(virtual_settings()).plant.rear_grooves


@lru_cache
def three_gaits() -> Seen:
    session = Session()
    session.run(LONG, 2)
    session.run(BACKWARD, stop_after=6.0)
    session.run(FORWARD_GAIT, 5, disturb=miss)
    return seen(session)


@pytest.mark.parametrize("memory", [True, False])
@pytest.mark.parametrize("number", range(3))
def test_of_three_gaits_exactly_the_disturbed_one_is_flagged_with_the_cause(
    number: int, memory: bool
):
    session = three_gaits()
    played = session.played[number]
    replay, report = replayed(session, played, memory=memory)
    assert grooves_of(replay.states, played) == played.grooves
    found = [(event.code, event.cycle) for _, event in report.events]
    if memory:
        assert found == live_codes(session, played)
        assert report.health is live_health(session, played)
    if number == 2:
        assert {code for code, _ in found} <= {"missed_groove_rear", "missed_groove"}
        assert found
        assert report.health in (Health.SUSPECT, Health.FAULTY)
    else:
        assert (found, report.health) == ([], Health.HEALTHY)


@pytest.mark.night
def test_a_memory_of_another_robot_is_not_resumed():
    session = three_gaits()
    played = session.played[1]
    run = recording(session.rows, session.live.memories, played.begin_ns, played.end_ns)
    other = PAPER.replace(viscous_friction=1.02 * PAPER.viscous_friction)
    replay = replay_run(run, other)
    assert [cycle.not_judged for cycle in replay.cycles] != []
    assert not [event.text for event in replay.notices if event.severity > Severity.INFO]


def live_codes(session: Seen, played: Played) -> list[tuple[str, int]]:
    return [
        (event.code, event.cycle)
        for event in session.live.events
        if event.severity > Severity.INFO and played.onset_ns <= event.stamp_ns <= played.end_ns
    ]


def replay_of(bag: Path) -> tuple[RunReport, ...]:
    """Return the report of the replay of a bag."""
    with open_bag(bag, pytest.fail) as opened:
        run = read_run(opened, names=REPLAY_INPUTS)
    replay = replay_run(run, PAPER)
    reports = report_replay(run, replay, PAPER.pitch).runs
    return tuple(map(of_causes, reports))


def findings(report: RunReport, first: int = 1) -> tuple[object, ...]:
    """Return health, events and grooves of a run's cycles from a number on."""
    cycles = [cycle for cycle in report.cycles if cycle.complete and cycle.number >= first]
    assert cycles
    return (
        report.health,
        [(event.code, event.cycle, event.stamp_ns) for _, event in report.events],
        [(cycle.number, cycle.grooves, cycle.not_judged) for cycle in cycles],
    )


@pytest.fixture(scope="module")
def whole_bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    session = three_gaits()
    end = session.played[-1].end_ns
    bag = tmp_path_factory.mktemp("parts") / "whole"
    return write_bag(bag, recording(session.rows, session.live.memories, 0, end))


@pytest.mark.parametrize(("after_onset_s", "first"), [(-1.0, 1), (5.0, 4)])
def test_a_trimmed_recording_is_replayed_like_the_whole(
    whole_bag: Path, tmp_path: Path, run, after_onset_s: float, first: int
):
    """A part that begins in a gait agrees from its second whole cycle on; the fourth is disturbed."""
    whole = replay_of(whole_bag)
    played = three_gaits().played[-1]
    with open_bag(whole_bag) as bag:
        start = (played.onset_ns - bag.start) * 1e-9 + after_onset_s
    arguments = ("trim", whole_bag, "--start", start, "--output", tmp_path / "part")
    assert run(bags, *arguments)[0] == 0
    (part,) = replay_of(tmp_path / "part")
    assert findings(part, first) == findings(whole[-1], first)


GAIT_REVERSE = Gait(0.07, 0.4, REVERSE)


def test_fins_that_turn_while_the_slack_is_taken_up_stay_in_their_grooves():
    """The gait before was stopped."""
    session = Session(virtual_settings(1))
    session.camera = False
    for gait, end in ((GAIT_REVERSE, {"stop_after": 3.2}), (Gait(0.07, 0.4), {})):
        session.run(gait, 2, before=1.6, after=1.2, **end)
    found = seen(session)
    for played in found.played:
        replay, report = replayed(found, played)
        assert grooves_of(replay.states, played) == grooves_of(found.live.states, played)
        assert [(e.code, e.cycle) for _, e in report.events] == live_codes(found, played)


TENSIONED = Gait(0.06, 0.4, pretension=0.02)


@pytest.mark.night
@pytest.mark.parametrize(
    ("rest", "pause", "gait"),
    [
        (1.0, 0.0, Gait(0.07, 0.4)),
        (2.2, 0.3, Gait(0.07, 0.4)),
        (5.0, 0.0, Gait(0.07, 0.4)),
        (5.0, 3.0, Gait(0.07, 0.4)),
        (1.0, 0.0, TENSIONED),
        (1.0, 2.5, TENSIONED),
    ],
)
def test_the_fins_grooves_are_known_whenever_the_fins_turn(rest: float, pause: float, gait: Gait):
    """The slack decides in which grooves the fins are turned. No camera corrects them."""
    session = Session(driver=driver_settings(rest_duration=rest))
    session.run(GAIT_REVERSE, 2, before=1.0, after=0.0)
    session.camera = False
    played = session.run(gait, 2, before=pause, after=1.0)
    found = seen(session)
    assert grooves_of(found.live.states, played) == played.grooves
    assert not any(c.not_judged for c in found.live.cycles if c.onset_ns == played.onset_ns)
    assert live_health(found, played) is Health.HEALTHY


SHAPED = Gait(
    0.065, 0.2, pretension=0.015, contraction_share=0.7, profile=Profile.TRAPEZOID, ramp_share=0.2
)
SHAPED_BACKWARD = Gait(0.06, 0.25, REVERSE, pretension=0.02, contraction_share=0.6)


@lru_cache
def shaped() -> Seen:
    """Return gaits with pretension and other shapes, forward and in reverse, one of them held at once."""
    session = Session()
    session.run(SHAPED, 2)
    session.run(SHAPED_BACKWARD, 2)
    session.run(SHAPED, stop_after=7.0)
    return seen(session)


@pytest.mark.parametrize("memory", [True, False])
@pytest.mark.parametrize("number", range(3))
def test_shaped_gaits_are_healthy_live_and_in_their_recordings(number: int, memory: bool):
    session = shaped()
    played = session.played[number]
    assert not any(
        e.code for e in session.live.events if e.code != "clock_jump"
    )  # the first sample
    assert grooves_of(session.live.states, played) == played.grooves
    assert live_health(session, played) is Health.HEALTHY
    replay, report = replayed(session, played, memory=memory)
    assert report.played.gait == played.gait
    assert grooves_of(replay.states, played) == played.grooves
    assert (report.health, list(report.events)) == (Health.HEALTHY, [])
