# SPDX-License-Identifier: Apache-2.0
"""The twin under loads:

known ones raise no alarm, changed ones are reported, and other causes are not mistaken for them.
"""

from functools import lru_cache

import numpy as np
import pytest
from faulty_robots import Fault, Robots, causes, run_robots
from virtual_session import Session, live_twin, recording, virtual_settings

from worm_model.analysis.replay_metrics import report_replay
from worm_model.gait import REVERSE, Gait
from worm_model.loads import under
from worm_model.parameters import PAPER
from worm_model.twin.cause_table import LASTING, LOAD_DOWN, LOAD_UP
from worm_model.twin.core.memory import POSITION, POWER
from worm_model.twin.data.records import Health
from worm_model.twin.offline_replay import replay_run
from worm_model.twin.signatures import signatures
from worm_model.twin.twin import Twin
from worm_msgs.conditions import Conditions

GAIT = Gait(0.08, 0.2)
SLOPES = ((20.0, 2.0), (-20.0, 0.0))  # deg, N of the tether
FAULTS = (
    ("load_up", Fault("rear_load", 1.0, 2, 0.0)),
    ("load_up", Fault("rear_load", 6.0, 3, 0.3)),
    ("load_up", Fault("both_loads", 3.0, 2, 0.6)),
    ("load_down", Fault("rear_load", -2.0, 2, 0.3)),
    ("load_down", Fault("both_loads", -4.0, 3, 0.0)),
)


@lru_cache
def climbed(slope: float, tether: float) -> Session:
    session = Session(virtual_settings(conditions=Conditions(slope_deg=slope, tether_n=tether)))
    session.run(GAIT, 3)
    session.run(Gait(0.07, 0.25, REVERSE), 2)
    return session


@pytest.mark.parametrize(("slope", "tether"), SLOPES)
def test_a_twin_with_the_right_load_follows_the_robot_live_and_in_replay(slope, tether):
    session = climbed(slope, tether)
    loaded = under(Conditions(slope_deg=slope, tether_n=tether), PAPER)
    live = live_twin(session.rows, Twin(loaded))
    assert {event.code for event in live.events} <= {"", "clock_jump"}  # the first sample
    assert live.residuals["health"].max() == Health.HEALTHY  # also while the fins turn
    for played in session.played:
        run = recording(session.rows, live.memories, played.begin_ns, played.end_ns)
        (report,) = report_replay(run, replay_run(run, loaded), loaded.pitch).runs
        assert (report.health, list(report.events)) == (Health.HEALTHY, [])
        complete = [cycle for cycle in report.cycles if cycle.complete]
        assert tuple(round(cycle.grooves) for cycle in complete) == played.grooves


def test_without_the_tracker_the_robot_starts_where_its_fins_hold_the_load():
    """The twin of a robot on a slope starts its first run with fins that the load has deflected."""
    slope, tether = SLOPES[0]
    session = climbed(slope, tether)
    loaded = under(Conditions(slope_deg=slope, tether_n=tether), PAPER)
    first = session.played[0]
    states = live_twin(session.rows, Twin(loaded)).states
    begun = states[np.searchsorted(states["stamp_ns"], first.onset_ns)]
    rear = begun["rear_position"] - begun["rear_anchor"]
    # Only the rear fin holds it, as the front fin is in its clearance.
    sag = 0.5 * PAPER.clearance + (loaded.rear_load + loaded.front_load) / PAPER.engaged_stiffness
    assert -rear == pytest.approx(sag, abs=1.5e-3)


@lru_cache
def robots() -> Robots:
    return run_robots(GAIT, [fault for _, fault in FAULTS], seed=3)


@pytest.mark.parametrize("number", range(len(FAULTS)))
def test_a_changed_load_is_named_first_and_power_alone_names_no_false_cause(number):
    """That no other cause is named a load is tested with the other causes."""
    expected = FAULTS[number][0]
    seen, unseen = (causes(robots().rows(number, tracker=tracker)) for tracker in (True, False))
    assert seen[0].code == expected
    assert {event.code for event in unseen} <= {expected, "ambiguous"}


@pytest.mark.parametrize("name", ["rear_load", "both_loads"])
def test_a_load_that_is_zero_has_a_signature_in_newtons(name):
    cause = LASTING[name]
    assert (cause.up, cause.down) == (LOAD_UP, LOAD_DOWN)
    small = signatures(GAIT, PAPER, driven=True).lasting[name][0]
    # At rest the fin yields by Q/(k_eng + k_dis), and the whole robot with it.
    shift = -cause.size / (PAPER.engaged_stiffness + PAPER.disengaged_stiffness)
    assert np.median(small[POSITION]) == pytest.approx(shift, rel=0.3)
    assert np.abs(small[POWER]).max() > 0.0


@pytest.mark.parametrize("load", [60.0, -60.0])
def test_a_load_that_the_fins_do_not_hold_does_not_end_the_twin(load):
    """The parameter file may be wrong; the robot moves all the same."""
    slides = PAPER.replace(rear_load=load)
    assert signatures(GAIT, slides, driven=False)
    session = climbed(*SLOPES[0])
    played = session.played[0]
    live = live_twin(session.rows, Twin(slides))
    assert live.residuals["health"].max() == Health.FAULTY
    run = recording(session.rows, live.memories, played.begin_ns, played.end_ns)
    (report,) = report_replay(run, replay_run(run, slides), slides.pitch).runs
    assert report.health == Health.FAULTY


def test_a_gait_that_is_longer_than_the_twins_body_does_not_end_the_twin():
    """L0 in the parameter file may be wrong, or a gait longer than the driver of this robot permits."""
    short = PAPER.replace(initial_length=GAIT.stroke)
    assert not signatures(GAIT, short, driven=False).missed


def test_a_parameter_at_its_limit_has_a_signature_from_the_permitted_side():
    """A larger clearance than twice the switching threshold is not permitted."""
    wide = PAPER.replace(clearance=1.9999 * PAPER.switching_threshold)
    assert signatures(GAIT, wide, driven=True).healthy["clearance"].any()
