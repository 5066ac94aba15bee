# SPDX-License-Identifier: Apache-2.0
"""No goal beyond its bounds is written, whichever code sends it: on the bytes of the virtual robot's servos."""

import pytest
from driver_rig import CABLE, Line
from hypothesis import given
from hypothesis import strategies as st

from worm_driver.driver_errors import RejectedError
from worm_driver.servos.goal_gate import Bound, GoalGate
from worm_driver.servos.position_track import PositionSample, PositionTrack
from worm_driver.servos.registers import COMMON

GOAL = COMMON["goal_position"]


class Gated(Line):
    """Gate to cable servo 1, whose position was 0 at the time 0."""

    def __init__(self, bound: Bound) -> None:
        super().__init__()
        self.track = PositionTrack({CABLE: 4.8})
        self.track.begin({CABLE: PositionSample(0, 0.0)})
        self.gate = GoalGate(self.bus, self.track)
        self.gate.bounds = {CABLE: bound}

    def goal(self) -> int:
        return self.bus.read(CABLE, GOAL)


@given(st.integers(-(10**6), 10**6), st.floats(0.0, 0.2))
def test_a_goal_is_within_the_range_and_the_reach_or_not_written(ticks, age):
    gated = Gated(Bound(-1000, 500, lead=400, speed=3000.0))
    before = gated.goal()
    gated.clock.now = age
    gated.gate.send({CABLE: ticks})
    reach = 400 + 3000.0 * age
    within = -1000 <= ticks <= 500 and abs(ticks) <= reach
    assert gated.bus.counters.withheld == (not within)
    assert gated.goal() == (ticks if within else before)
    assert gated.gate.last_sent(CABLE) == (ticks if within else None)


def test_an_acknowledged_goal_has_the_same_bounds_and_names_its_reason():
    gated = Gated(Bound(-300, 500, lead=400))
    gated.gate.write(CABLE, -300)
    with pytest.raises(RejectedError, match=r"501.*-300 to 500"):
        gated.gate.write(CABLE, 501)
    assert gated.goal() == -300
    with pytest.raises(RejectedError, match=r"401.* 400 ticks from .* 0 ticks"):
        gated.gate.write(CABLE, 401)
    with pytest.raises(RejectedError, match=r"servo 11\b.* no bounds"):
        gated.gate.write(11, 0)
    gated.track.mark_lost(CABLE, 4096)
    with pytest.raises(RejectedError, match="unknown"):
        gated.gate.write(CABLE, 1)


def test_a_servo_without_bounds_or_with_a_lost_position_gets_no_goal():
    gated = Gated(Bound(-1000, 500))
    before = gated.goal()
    gated.track.record_if_plausible(11, 1500, 0.0)
    gated.track.mark_lost(CABLE, 4096)
    gated.gate.send({CABLE: 1, 11: 1500})
    assert gated.goal() == before
    assert gated.bus.counters.withheld == 2
