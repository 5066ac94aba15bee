# SPDX-License-Identifier: Apache-2.0
"""The driver acts on what it measures, servo by servo: rest, holds, and several cable servos. Byte for byte."""

import itertools
import math
import re

import pytest
from driver_rig import CABLE, Rig, idle, moving, settings, shaft_lengths, slow_down, two_spools

from worm_driver.driver_errors import HomingError
from worm_driver.gait.gait_player import Phase

#: m, a robot that is contracted by less does not spring back
REST = 0.002
#: s, in which every servo must stand after a stop, and m/s, below which it stands
STOP, STILL = 0.100, 0.002
#: m, by which a cable moves while the force of its body decays or builds up
YIELD = 0.0015


def stopped(rig: Rig, length: float) -> Rig:
    """Contract a robot in a gait as fast as its limit permits, stop it at a length change (m), and return the rig."""
    stroke = -length * 1.2
    rig.start(stroke, min(0.4, 0.95 * rig.settings.max_cable_speed / math.pi / stroke))
    rig.run(60.0, until=lambda s: s.player.length_change < length)
    rig.robot.stop(rig.clock.now, "stop")
    rig.run(0.5)
    return rig


def slow(speed: float, **changes: object) -> Rig:
    """Return an active driver whose cable is limited to a speed (m/s)."""
    rig = Rig(settings(max_cable_speed=speed, **changes))
    rig.activate()
    return rig


# --- rest ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("speed", "deed"),
    [(0.01, "shutdown"), (0.02, "deactivate"), (0.03, "shutdown"), (0.12, "deactivate")],
)
def test_torque_goes_off_only_at_measured_rest_however_slow_the_cable_is(speed, deed):
    rig = stopped(slow(speed), -0.03)
    longest = 2 * math.pi / 2 * 0.035 / min(speed, 0.05) + 2.0
    if deed == "deactivate":
        rig.deactivate(longest)
    else:
        rig.loop.shutdown("the driver ends")
        rig.run(longest, until=lambda _: rig.ended)
        assert rig.end() == []
    assert rig.contraction <= REST
    assert rig.robot.actuators.sprung_back == ""
    assert rig.torques == [0, 0, 0]
    assert rig.cable.memory["bus_watchdog"] == 0


def test_a_run_begins_at_measured_rest():
    rig = stopped(slow(0.02), -0.03)
    slow_down(rig.virtual.servos[0], 0.015)
    rig.start(0.02, 0.1, cycles=1)
    rig.run(20.0, until=lambda s: s.player.phase is Phase.FLIPPING)
    assert rig.contraction <= REST


def held_back(rate: float = 100.0) -> Rig:
    """Return a rig in FAULT: its servo was too slow for a short return to rest."""
    rig = stopped(slow(0.12, rate=rate), -0.01)
    slow_down(rig.virtual.servos[0], 0.0012)
    rig.robot.ramp_to_rest(rig.clock.now, "deactivated")
    rig.run(2.0, until=lambda s: s.player.phase is not Phase.RETURNING)
    assert rig.robot.player.phase is Phase.FAULT
    return rig


@pytest.mark.parametrize("rate", [100.0, 20.0])
def test_a_cable_that_does_not_come_to_rest_is_a_fault_with_its_measured_length(rate):
    rig = held_back(rate)
    assert not rig.robot.released
    message = rig.robot.player.message
    (at,) = re.findall(r"servo 1 is .* \(at (-?[\d.]+) mm instead of -?0.0 mm\)", message)
    assert -float(at) * 1e-3 == pytest.approx(rig.contraction, abs=2e-4)
    assert "too slow" in message


def test_a_driver_that_ends_without_measured_rest_leaves_the_torque_on():
    rig = held_back()
    rig.loop.shutdown("the driver ends")
    rig.run(5.0, until=lambda _: rig.ended)
    (problem,) = rig.end()
    assert f"contracted by {rig.contraction * 1e3:.1f} mm at servo 1" in problem
    assert rig.torques[0] == 1


@pytest.mark.parametrize("deed", ["deactivate in fault", "second Ctrl-C"])
def test_a_person_who_releases_a_contracted_robot_gets_the_measured_contraction(deed):
    rig = held_back() if deed == "deactivate in fault" else moving()
    before = rig.contraction
    if deed == "deactivate in fault":
        rig.robot.ramp_to_rest(rig.clock.now, "deactivated")
        assert rig.robot.released
        assert rig.robot.release() == []
    else:
        rig.loop.release_at_once()
        assert rig.end() == []
    assert rig.torques == [0, 0, 0]
    assert before > REST
    words = rig.robot.actuators.sprung_back.split()
    assert float(words[words.index("mm") - 1]) == pytest.approx(before * 1e3, abs=1.0)
    rig.run(1.0)
    rig.robot.activate(rig.clock.now)
    assert rig.robot.actuators.sprung_back == ""


def test_a_silent_servo_counts_as_contracted_if_it_may_still_move_there():
    rig = idle()
    rig.start(0.07, 0.4)
    rig.run(5.0, until=lambda s: s.player.phase is Phase.RUNNING and s.cable < -0.0005)
    rig.inject("no_answer", target=CABLE, duration=1e6)
    rig.run(1.0, until=lambda s: s.player.phase is Phase.FAULT)
    rig.run(0.5)
    assert rig.contraction > REST
    assert rig.robot.actuators.contracted
    rig.robot.shutdown()
    assert rig.torques[0] == 1


@pytest.mark.parametrize("delay", range(11, 17))
def test_a_robot_that_may_still_move_out_of_rest_is_not_released(delay):
    emergency = ""
    rig = Rig(why_not_start=lambda: emergency).play(0.09, 0.4)
    rig.run(0.01 * delay)
    emergency = "the emergency stop is on"
    rig.robot.stop(rig.clock.now, emergency)
    releases = rig.robot.released
    rig.positions.clear()
    rig.run(0.5)
    assert rig.contraction <= REST or not releases
    assert releases or delay > 11


# --- holds -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("length", "deed", "times"), [(-0.05, "stop", 100), (0.0, "stop", 1), (-0.05, "overload", 1)]
)
def test_neither_a_stop_nor_a_fault_changes_the_goal_of_a_cable_that_stands(length, deed, times):
    rig = slow(0.12)
    if length:
        stopped(rig, length)
    rig.run(0.2)
    before, held = rig.contraction, {goal.ticks for goal in rig.goals[-3:] if goal.servo == CABLE}
    rig.goals.clear()
    for _ in range(times):
        if deed == "stop":
            rig.robot.stop(rig.clock.now, "the emergency stop is on")
        else:
            rig.inject(deed, target=12)
        rig.run(2.0 / times)
    assert (rig.robot.player.phase is Phase.FAULT) == (deed == "overload")
    assert {goal.ticks for goal in rig.goals if goal.servo == CABLE} == held
    assert rig.contraction == pytest.approx(before, abs=2e-4)


def test_a_return_begins_at_the_goal_of_the_hold():
    rig = stopped(slow(0.12), -0.05)
    rig.goals.clear()
    rig.deactivate(5.0)
    goals = [goal.ticks for goal in rig.goals if goal.servo == CABLE]
    ticks = rig.settings.spools[0].ticks(-0.05 * 0.0101)  # 10 ms at 50 mm/s
    assert all(0 <= a - b <= ticks for a, b in itertools.pairwise(goals))


def test_drivers_that_are_killed_and_take_over_do_not_let_the_cable_down():
    rig = stopped(slow(0.12), -0.05)
    before = rig.contraction
    for _ in range(10):
        rig.clock.now += 0.5  # the bus watchdog fires
        rig = rig.restarted_driver(settings(home_at_start=False))
        rig.robot.activate(rig.clock.now)
        rig.run(0.3)
    assert rig.contraction == pytest.approx(before, abs=5e-4)


# --- several cable servos ----------------------------------------------------------------------------


def apart(distance: float) -> Rig:
    """Return a driver of two spools whose second one was turned by a distance (m) without torque."""
    rig = two_spools()
    servo = rig.virtual.servos[1]
    ticks = rig.settings.spools[1].ticks(-distance)
    servo.motor = servo.motor._replace(position=servo.motor.position + ticks)
    rig.run(0.1)
    return rig


@pytest.mark.parametrize("distance", [0.004, -0.004])
def test_activation_holds_each_servo_where_it_is(distance):
    rig = apart(distance)
    before = shaft_lengths(rig)
    rig.robot.activate(rig.clock.now)
    rig.run(1.0)
    assert rig.robot.player.phase is Phase.IDLE
    assert shaft_lengths(rig) == pytest.approx(before, abs=3e-4)
    assert rig.bus.counters.withheld == 0
    rig.deactivate(2.0)
    assert rig.contraction <= REST


@pytest.mark.parametrize("distance", [0.006, 0.031, -0.009])
def test_activation_rejects_cables_that_differ(distance):
    rig = apart(distance)
    before = shaft_lengths(rig)
    with pytest.raises(HomingError) as caught:
        rig.robot.activate(rig.clock.now)
    named = re.findall(r"servo (\d) (?:is )?at (-?[\d.]+) mm", str(caught.value))
    assert [servo for servo, _ in named] == ["1", "2"]
    assert [float(length) * 1e-3 for _, length in named] == pytest.approx(before, abs=2e-4)
    assert rig.torques == [0, 0, 0, 0]
    assert shaft_lengths(rig) == pytest.approx(before, abs=5e-4)


@pytest.mark.parametrize("index", [0, 1])
def test_one_lagging_servo_is_a_fault_of_this_servo(index):
    rig = two_spools().play(0.06, 0.3)
    slow_down(rig.virtual.servos[index], 0.006)
    rig.run(8.0, until=lambda s: s.player.phase is Phase.FAULT)
    assert f"the cable of servo {index + 1} is" in rig.robot.player.message
    lengths = shaft_lengths(rig)
    assert abs(lengths[0] - lengths[1]) < 0.025


def lagging(index: int, lag: float) -> Rig:
    """Return a driver of two spools in a gait, one of which lags behind the other one by a length (m)."""
    rig = two_spools().play(0.06, 0.3)
    slow_down(rig.virtual.servos[index], 0.006)
    rig.run(8.0, until=lambda _: abs(shaft_lengths(rig)[0] - shaft_lengths(rig)[1]) > lag)
    rig.robot.stop(rig.clock.now, "stop")
    return rig


@pytest.mark.parametrize("lag", [0.004, 0.010])
@pytest.mark.parametrize("index", [0, 1])
def test_after_a_stop_each_servo_holds_where_it_is(index, lag):
    rig = lagging(index, lag)
    begin, before, last = rig.clock.now, shaft_lengths(rig), rig.clock.now
    while rig.clock.now < begin + 2.0:
        rig.clock.now += 0.005
        if any(
            abs(s.motor.velocity) * 0.025 * math.tau / 4096 > STILL for s in rig.virtual.servos[:2]
        ):
            last = rig.clock.now
        rig.run(0.005)
    assert last - begin <= STOP
    assert rig.robot.player.phase is Phase.HOLDING
    for now, then in zip(shaft_lengths(rig), before, strict=True):
        assert now == pytest.approx(then, abs=0.005)
    assert abs(shaft_lengths(rig)[index] - before[index]) < YIELD


def test_servos_that_hold_at_different_lengths_return_to_rest_together():
    rig = lagging(1, 0.010)
    rig.run(0.5)
    slow_down(rig.virtual.servos[1], 0.12)
    rig.goals.clear()
    rig.deactivate(5.0)
    assert rig.contraction <= REST
    for spool in rig.settings.spools:
        lengths = [spool.length_change(g.ticks) for g in rig.goals if g.servo == spool.servo]
        steps = [b - a for a, b in itertools.pairwise(lengths)]
        assert min(steps) >= 0.0
        assert max(steps) <= 0.05 * rig.settings.period * 1.1
    rig.play(0.03, 0.3, cycles=1)
    rig.run(1.0)
    ticks = [goal.ticks for goal in rig.goals[-4:-2]]
    assert ticks[0] == -ticks[1]


def test_one_blocked_servo_of_two_stops_both():
    rig = two_spools(max_following_error=1.0).play(0.06, 0.3)
    rig.run(0.7)
    rig.inject("stalled", target=2, duration=1e6)
    fault = rig.run(1.0, until=lambda s: s.player.phase is Phase.FAULT)
    assert "servo 2 is beyond its limit" in fault.player.message
    rig.run(0.3)
    assert abs(rig.snapshots[-1].servos[1].effort) < 0.5 * rig.settings.max_servo_current
