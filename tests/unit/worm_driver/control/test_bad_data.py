# SPDX-License-Identifier: Apache-2.0
"""The driver never moves the robot on bad data: wrong samples on the bus, judged by the goals that are written."""

import itertools
from collections.abc import Iterator

import pytest
from driver_rig import CABLE, Rig, idle, moving, settings, two_spools
from hypothesis import given
from hypothesis import strategies as st

from worm_driver.control.robot import CycleSnapshot
from worm_driver.driver_errors import DriverError
from worm_driver.gait.gait_player import Phase
from worm_driver.servos.state_reader import SILENT

GIVEN = settings()
#: m, from the shaft to a goal: the tolerated following error, and two cycles at full speed
REACH = GIVEN.max_following_error + 2 * GIVEN.period * GIVEN.max_cable_speed
#: m, largest motion of a standing robot, and largest offset of a hold, because of one wrong sample
STANDS = 0.001
JUMPS = [-8192, -600, -200, 200, 1000, 12288]
FIN = 11


def moved(rig: Rig, since: int) -> float:
    """Return the range of the cable's positions in m since a count of positions."""
    positions = [position for _, position in rig.positions[since:]]
    return abs(GIVEN.spools[0].length_change(max(positions) - min(positions)))


def check_goals(rig: Rig, since: int = 0) -> None:
    """Assert that every goal on the bus is within the stroke and within reach of the shaft."""
    low, high = GIVEN.spools[0].ticks(0.0101), GIVEN.spools[0].ticks(-GIVEN.max_stroke - 0.0101)
    for goal in rig.goals[since:]:
        if goal.servo == CABLE:
            assert low <= goal.ticks <= high, goal
            assert goal.distance <= REACH, goal


@pytest.mark.parametrize("make", [idle, moving])
@pytest.mark.parametrize("jump", JUMPS)
def test_one_wrong_sample_moves_nothing_and_ends_nothing(jump, make):
    rig = make()
    since, begin, phase = len(rig.positions), len(rig.snapshots), rig.robot.player.phase
    rig.inject("wrong_position", target=CABLE, count=1, value=jump)
    rig.run(0.5)
    assert rig.bus.counters.implausible == 1
    assert rig.robot.player.phase is phase
    assert phase is Phase.RUNNING or moved(rig, since) < STANDS
    lengths = [s.cable for s in rig.snapshots[begin:]]
    assert lengths == pytest.approx([s.commanded for s in rig.snapshots[begin:]], abs=6e-3)
    check_goals(rig)


def test_one_wrong_sample_after_a_missing_answer_is_no_second_reading():
    rig = idle()
    since = len(rig.positions)
    rig.inject("no_answer", target=CABLE, count=1)  # consumes the first of the wrong positions, too
    rig.inject("wrong_position", target=CABLE, count=2, value=600)
    rig.run(1.0)
    assert rig.bus.counters.implausible == 1
    assert rig.robot.player.phase is Phase.IDLE
    assert moved(rig, since) < STANDS
    check_goals(rig)


@pytest.mark.parametrize("count", [2, 0], ids=["twice", "for ever"])
@pytest.mark.parametrize("jump", JUMPS)
def test_wrong_samples_while_idle_are_a_fault_and_move_nothing(jump, count):
    rig = idle()
    since = len(rig.positions)
    length = {"count": count} if count else {"duration": 1e6}
    rig.inject("wrong_position", target=CABLE, value=jump, **length)
    snapshot = rig.run(2.0)
    assert snapshot.player.phase is Phase.FAULT
    assert f"servo 1 jumped by {jump} ticks" in snapshot.player.message
    assert moved(rig, since) < STANDS
    assert rig.cable.memory["torque_enable"] == 1
    check_goals(rig)


@pytest.mark.parametrize("jump", JUMPS)
def test_wrong_samples_during_a_gait_stop_it_where_it_is(jump):
    rig = moving()
    rig.inject("wrong_position", target=CABLE, value=jump, duration=1e6)
    here = rig.cable.shaft.position
    assert rig.time_to_stop(1.0) < 0.100
    assert rig.robot.player.phase is Phase.FAULT
    travelled = abs(GIVEN.spools[0].length_change(rig.cable.shaft.position - here))
    assert travelled < 0.010  # at 88 mm/s
    published = [s.cable for s in rig.snapshots if s.servos[0] is not SILENT]
    shafts = [GIVEN.spools[0].length_change(at - rig.home_ticks) for _, at in rig.positions]
    assert min(shafts) - 1e-3 <= min(published) <= max(published) <= max(shafts) + 1e-3
    check_goals(rig)


@given(
    st.lists(
        st.tuples(st.integers(0, 8), st.integers(-5000, 5000), st.integers(1, 3)),
        min_size=1,
        max_size=6,
    ),
    st.booleans(),
)
def test_sequences_of_wrong_samples(errors, in_motion):
    rig = moving() if in_motion else idle()
    here = rig.cable.shaft.position
    for cycles, jump, count in errors:
        rig.inject("wrong_position", target=CABLE, count=count, value=jump)
        if cycles:
            rig.run(cycles * GIVEN.period)
    rig.run(0.5)
    check_goals(rig)
    if not in_motion:
        assert abs(GIVEN.spools[0].length_change(rig.cable.shaft.position - here)) < 0.006


def test_a_wrong_sample_at_a_stop_does_not_move_the_hold():
    rig = moving()
    rig.inject("wrong_position", target=CABLE, count=1, value=1000)
    rig.run(GIVEN.period)
    here = rig.cable.shaft.position
    rig.robot.stop(rig.clock.now, "stop")
    assert rig.time_to_stop(0.5) < 0.100
    assert abs(GIVEN.spools[0].length_change(rig.cable.shaft.position - here)) < 0.005
    check_goals(rig)


def drifting(rig: Rig, servo: int, ticks_per_cycle: int, cycles: int) -> Iterator[CycleSnapshot]:
    """Run cycles in which the samples of a servo drift away from its shaft."""
    for step in range(cycles):
        rig.virtual.board.clear()
        rig.inject("wrong_position", target=servo, value=step * ticks_per_cycle, duration=1e6)
        yield rig.run(GIVEN.period)


@pytest.mark.parametrize("ticks_per_cycle", [5, 110])
def test_samples_that_drift_become_a_fault_and_move_nothing(ticks_per_cycle):
    """Each step is possible for the servo. But no servo pulls at the position that the samples report."""
    rig = idle()
    since = len(rig.positions)
    assert list(drifting(rig, CABLE, ticks_per_cycle, 400))[-1].player.phase is Phase.FAULT
    assert moved(rig, since) < STANDS
    check_goals(rig)


@pytest.mark.parametrize("seconds", [0.2, 0.6, 0.8], ids=["slow", "pulling", "at the turn"])
@pytest.mark.parametrize("ticks_per_cycle", [-100, 30])
def test_samples_that_drift_during_a_gait_do_not_move_the_hold(ticks_per_cycle, seconds):
    """A gait pulls with more than half of the limit: that alone does not support a measurement."""
    rig = idle().play()
    rig.run(seconds)
    snapshots = drifting(rig, CABLE, ticks_per_cycle, 100)
    assert any(snapshot.player.phase is Phase.FAULT for snapshot in snapshots)
    since = len(rig.positions)
    rig.run(0.5)
    assert moved(rig, since) < 0.006
    check_goals(rig)


# --- ids ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("count", [1, 4, 0], ids=["once", "four times", "for ever"])
@pytest.mark.parametrize(
    ("sender", "claimed", "quiet"), [(11, 1, 0), (12, 1, 1), (1, 11, 0), (12, 11, 1), (1, 77, 0)]
)
def test_a_status_packet_with_another_servos_id_moves_nothing(sender, claimed, quiet, count):
    rig = idle()
    since = len(rig.positions)
    length = {"count": count} if count else {"duration": 1e6}
    rig.inject("wrong_id", target=sender, value=claimed, **length)
    if quiet:
        rig.inject("no_answer", target=quiet, **length)
    rig.run(1.0)
    if not count:
        assert rig.robot.player.phase is Phase.FAULT
    assert moved(rig, since) < STANDS
    check_goals(rig)


@pytest.mark.parametrize("sender", [11, 12])
def test_another_servos_packet_during_a_gait(sender):
    rig = moving()
    rig.inject("wrong_id", target=sender, value=CABLE, duration=1e6)
    rig.inject("no_answer", target=CABLE, duration=1e6)
    assert rig.time_to_stop(1.0) < 0.100
    assert rig.robot.player.phase is Phase.FAULT
    check_goals(rig)


# --- activation and homing -----------------------------------------------------------------------


def before_nth_read(rig: Rig, number: int, deed) -> None:
    """Call a function before the nth read or sync read of a present position from now on."""
    send, left = rig.wire.write, [number]

    def write(packet: bytes) -> int:
        covers = int.from_bytes(packet[8:10], "little") in (120, 132)
        if packet[7] in (2, 0x82) and covers:
            left[0] -= 1
            if left[0] == 0:
                deed()
        return send(packet)

    rig.wire.write = write


@pytest.mark.parametrize("takes_over", [False, True])
@pytest.mark.parametrize("number", range(1, 11))
def test_a_wrong_sample_at_any_moment_of_an_activation_moves_nothing(number, takes_over):
    """If a contracted robot is taken over, its torque is on: a wrong goal would act at once."""
    rig = moving().restarted_driver(settings(home_at_start=False)) if takes_over else Rig()
    rig.run(0.1)
    assert bool(rig.robot.actuators.left_on) == takes_over
    since, jump = len(rig.positions), (-600, 4096)[number % 2]
    before_nth_read(
        rig, number, lambda: rig.inject("wrong_position", target=CABLE, count=1, value=jump)
    )
    rig.robot.activate(rig.clock.now)
    rig.run(0.5)
    assert moved(rig, since) < STANDS
    assert takes_over or rig.robot.player.phase is Phase.IDLE
    check_goals(rig)


@pytest.mark.parametrize("jump", [5, 600])
@pytest.mark.parametrize("number", range(1, 8))
def test_a_wrong_sample_while_homing_does_not_move_the_home(number, jump):
    rig = Rig()
    before_nth_read(
        rig, number, lambda: rig.inject("wrong_position", target=CABLE, count=1, value=jump)
    )
    try:
        rig.robot.home()
    except DriverError:
        assert not rig.robot.actuators.homed
    else:
        shaft = rig.cable._encoder.raw(rig.cable.shaft.position)
        assert abs(shaft) <= 10


# --- several cable servos -------------------------------------------------------------------------


@pytest.mark.parametrize("servo", [1, 2])
@pytest.mark.parametrize("jump", [-600, 4096])
def test_a_wrong_position_of_one_of_two_cable_servos_stops_both(servo, jump):
    rig = two_spools()
    rig.play(0.05, 0.4, cycles=3)
    rig.run(0.6)
    rig.inject("wrong_position", target=servo, value=jump, duration=1e6)
    here = [s.shaft.position for s in rig.virtual.servos]
    rig.run(1.0)
    assert rig.robot.player.phase is Phase.FAULT
    for shaft, virtual in zip(here, rig.virtual.servos[:2], strict=False):
        assert abs(GIVEN.spools[0].length_change(virtual.shaft.position - shaft)) < 0.010
    assert all(goal.distance <= REACH for goal in rig.goals)


def test_a_stop_right_after_an_activation_holds_where_the_servo_was_enabled():
    """The body still springs back: a position from before the activation must not be held."""
    rig = moving()
    rig.robot.release()
    rig.run(0.02)
    rig.robot.activate(rig.clock.now)
    enabled_at = rig.robot.player.length_change
    assert rig.snapshots[-1].cable - enabled_at < -0.002
    rig.robot.stop(rig.clock.now, "stop")
    assert rig.robot.player.length_change == enabled_at


# --- fins -----------------------------------------------------------------------------------------


def flipping() -> Rig:
    rig = idle()
    rig.start(0.05, 0.4, cycles=1, direction=-1)
    rig.run(1.0, until=lambda s: s.player.phase is Phase.FLIPPING)
    rig.run(0.15)
    assert abs(rig.virtual.servos[1].motor.velocity) > 500  # ticks/s
    return rig


def fin_positions(rig: Rig) -> list[float]:
    return [servo.motor.position for servo in rig.virtual.servos[1:]]


@pytest.mark.parametrize("deed", ["stop", "fault"])
def test_a_stop_stops_the_fins_too(deed):
    rig = flipping()
    if deed == "stop":
        rig.robot.stop(rig.clock.now, "emergency stop")
    else:
        rig.robot.fail(rig.clock.now, "a fault")
    rig.run(0.1)
    stopped = fin_positions(rig)
    rig.run(1.0)
    assert fin_positions(rig) == pytest.approx(stopped, abs=5)
    assert all(abs(servo.motor_angle - 3.927) > 0.3 for servo in rig.virtual.servos[1:])


def test_after_a_stop_during_a_flip_the_next_gait_sets_the_fins_at_rest():
    rig = flipping()
    rig.robot.stop(rig.clock.now, "stop")
    rig.run(0.5)
    rig.play(0.03, 0.4, cycles=1, direction=-1)
    for servo in rig.virtual.servos[1:]:
        assert servo.motor_angle == pytest.approx(3.927, abs=0.07)


@pytest.mark.parametrize("ticks_per_cycle", [-60, 3, 60])
def test_a_fin_that_stands_keeps_its_goal_at_a_stop_whatever_its_samples_are(ticks_per_cycle):
    rig = idle().play(0.05, 0.3)
    here = fin_positions(rig)
    list(drifting(rig, FIN, ticks_per_cycle, 25))
    rig.robot.stop(rig.clock.now, "stop")
    rig.run(1.0)
    assert fin_positions(rig) == pytest.approx(here, abs=40)


@pytest.mark.parametrize("jump", [-600, 600])
def test_a_wrong_position_of_a_fin_during_a_stop_moves_no_fin_there(jump):
    rig = flipping()
    rig.inject("wrong_position", target=FIN, value=jump, duration=1e6)
    rig.run(0.02)
    rig.robot.stop(rig.clock.now, "stop")
    here = fin_positions(rig)
    rig.run(1.0)
    assert fin_positions(rig) == pytest.approx(here, abs=200)


# --- late cycles ----------------------------------------------------------------------------------


@pytest.mark.parametrize("late", [0.02, 0.05])
def test_a_return_to_rest_keeps_to_its_speed_after_late_cycles(late):
    rig = moving()
    rig.robot.stop(rig.clock.now, "stop")
    rig.run(0.5)
    rig.robot.ramp_to_rest(rig.clock.now, "over")
    rig.goals.clear()
    while not rig.robot.released:
        rig.run(0.1)
        rig.clock.now += late
    assert rig.robot.player.phase is Phase.IDLE
    lengths = [GIVEN.spools[0].length_change(g.ticks) for g in rig.goals if g.servo == CABLE]
    fastest = max(b - a for a, b in itertools.pairwise(lengths)) / GIVEN.period
    assert fastest < 1.1 * GIVEN.player.return_speed
