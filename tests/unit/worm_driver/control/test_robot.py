# SPDX-License-Identifier: Apache-2.0
"""The driver's robot on the byte-level virtual robot, on a clock that only the test advances."""

import math
import re
from collections.abc import Callable
from dataclasses import replace

import pytest
from driver_rig import CABLE, Rig, idle, moving, rig_of_model, settings

from worm_driver.driver_errors import BusError, ConfigurationError, HomingError, RejectedError
from worm_driver.gait.gait_player import Ending, Phase
from worm_driver.servos.registers import COMMON
from worm_driver.servos.state_reader import SILENT
from worm_driver.virtual_robot.servo.control_table import (
    XL330_M288,
    XL430_W250,
    XM430_W350,
)
from worm_msgs.gait import Gait

#: s, in which motion must have stopped after a fault that endangers the robot
STOP = 0.100


@pytest.fixture
def rig() -> Rig:
    return Rig()


def before_write(rig: Rig, servo: int, register: str, deed: Callable[[], None]) -> None:
    """Call a function before a register of a servo is written for the first time from now on."""
    send, row = rig.wire.write, COMMON[register]

    def write(packet: bytes) -> int:
        address = int.from_bytes(packet[8:10], "little")
        if (packet[4], packet[7], address) == (servo, 3, row.address) and rig.wire.write is write:
            rig.wire.write = send
            deed()
        return send(packet)

    rig.wire.write = write


# --- configure, activate, release -----------------------------------------------------------------


def test_activation_holds_the_servos_where_they_stand_with_the_watchdog_armed(rig):
    before = [servo.shaft.position for servo in rig.virtual.servos]
    rig.activate()
    rig.run(0.5)
    after = [servo.shaft.position for servo in rig.virtual.servos]
    assert after == pytest.approx(before, abs=6)  # the pretension of the bellows, 0.2 mm
    for servo in rig.virtual.servos:
        assert servo.memory["torque_enable"] == 1
        assert servo.memory["bus_watchdog"] == 4  # 80 ms
        assert servo.memory["profile_velocity"] > 0


def test_no_servo_has_its_torque_before_every_one_has_its_limits(rig):
    """Otherwise the watchdog of the first one runs while the last one is still being set up."""
    rig.run(0.1)
    begin = len(rig.wire.sent)
    rig.robot.activate(rig.clock.now)
    writes = [packet for packet in rig.wire.sent[begin:] if packet[7] == 3]
    addresses = [int.from_bytes(packet[8:10], "little") for packet in writes]
    speeds, torques = COMMON["profile_velocity"].address, COMMON["torque_enable"].address
    last_speed = max(i for i, address in enumerate(addresses) if address == speeds)
    assert last_speed < addresses.index(torques)


def test_activation_rejects_a_supply_out_of_range(rig):
    rig.inject("input_voltage", target=CABLE, value=8.0)
    rig.run(0.1)
    with pytest.raises(ConfigurationError, match="servo 1 "):
        rig.robot.activate(rig.clock.now)
    assert rig.cable.memory["torque_enable"] == 0


def test_an_activation_that_fails_halfway_takes_the_torque_off_again(rig):
    rig.run(0.1)
    rig.inject("error", target=12, duration=10.0, value=7)
    with pytest.raises(BusError, match="servo 12 "):
        rig.robot.activate(rig.clock.now)
    assert rig.torques == [0, 0, 0]
    assert not rig.robot.active


def test_a_release_that_no_servo_acknowledges_still_takes_the_torque_off():
    rig = moving()
    rig.inject("no_answer", duration=10.0)
    problems = rig.robot.release()
    assert any("servo 1 does not answer" in problem for problem in problems)
    assert rig.torques == [0, 0, 0]


def test_a_release_without_a_port_is_reported_and_raises_nothing():
    rig = moving()
    rig.wire.unplugged = True
    assert any("is gone" in problem for problem in rig.robot.release())


# --- the answer of a stop -------------------------------------------------------------------------


def test_a_stop_reports_whether_the_robot_holds(rig):
    assert rig.robot.stop(rig.clock.now, "asked to") == "nothing to stop: the torque is off"
    rig.activate()
    assert rig.robot.stop(rig.clock.now, "asked to") == "stopped, and holding"


@pytest.mark.parametrize("cause", ["left on", "release failed"])
def test_a_stop_does_not_claim_that_a_torque_is_off_that_may_be_on(cause):
    rig = moving()
    if cause == "left on":
        rig = rig.restarted_driver(settings(home_at_start=False))
        rig.run(0.1)
        assert rig.cable.memory["torque_enable"] == 1
        expected = "left the torque on"
    else:
        rig.inject("no_answer", duration=10.0)
        expected = rig.robot.release()[0]
    message = rig.robot.stop(rig.clock.now, "asked to")
    assert "torque is off" not in message
    assert expected in message


# --- gaits ----------------------------------------------------------------------------------------


def test_a_gait_while_inactive_is_rejected(rig):
    with pytest.raises(RejectedError, match="activate the driver first"):
        rig.start()


def test_the_servos_velocity_limit_is_a_limit_of_gaits():
    rig = Rig(settings(spool_radii=(0.012,)))
    rig.activate()
    with pytest.raises(RejectedError, match=r"limit is 0\.0575 m/s"):
        rig.start(0.09, 0.4)


def test_the_end_of_each_run_is_in_a_snapshot_however_soon_the_next_one_begins():
    """Otherwise the goal of that run would never receive its result."""
    rig = idle()
    gait = Gait(0.03, 0.4)
    for _ in range(3):
        rig.loop.submit(lambda now: rig.robot.start(now, gait, 1))
        rig.loop.submit(lambda now: rig.robot.stop(now, "stop"))
    rig.run(0.1)
    runs = [snapshot.player.run for snapshot in rig.snapshots]
    assert {run.number for run in runs if run and run.ending is Ending.STOPPED} == {1, 2, 3}


# --- faults: each while the cable moves at full speed ---------------------------------------------


@pytest.mark.parametrize(
    ("fault", "arguments", "expected"),
    [
        ("no_answer", {"target": 1, "duration": 5.0}, "servo 1 .* no state .* does not answer"),
        ("no_answer", {"target": 11, "duration": 5.0}, "servo 11 .* no state"),
        ("no_answer", {"duration": 5.0}, "does not answer"),
        ("corrupted_crc", {"duration": 5.0}, "does not answer"),
        ("truncated", {"duration": 5.0}, "does not answer"),
        ("fuzzed", {"duration": 5.0}, "servo 1"),
        ("late", {"duration": 5.0, "value": 0.012}, "answers late"),
        ("late", {"count": 1, "value": 0.045}, "does not answer"),
        ("error", {"target": 1, "duration": 5.0, "value": 4}, "out of range"),
        ("error", {"target": 12, "duration": 5.0, "value": 7}, "servo 12 .* rejects the access"),
        ("vanished", {"target": 12, "duration": 5.0}, "servo 12 .* no state"),
        ("stalled", {"target": 1, "duration": 5.0}, "blocked"),
        ("overload", {"target": 12}, "servo 12 reports overload"),
        ("overheating", {"target": 12, "duration": 5.0}, "servo 12 reports overheating"),
        ("input_voltage", {"target": 12, "duration": 5.0}, "servo 12 reports input voltage"),
    ],
)
def test_a_fault_stops_the_motion_within_100_ms_and_is_named(fault, arguments, expected):
    rig = moving()
    if fault == "overheating":  # a servo warms up: only the time since its report counts
        rig.inject(fault, **arguments)
        rig.run(3.0, until=lambda s: s.player.phase is Phase.FAULT)
        assert rig.virtual.servos[2].memory["hardware_error_status"]
    else:
        rig.inject(fault, **arguments)
    assert rig.time_to_stop(1.0) < STOP
    player = rig.robot.player
    assert player.phase is Phase.FAULT
    assert player.run.ending is Ending.FAILED
    assert re.search(expected, player.message), player.message
    with pytest.raises(RejectedError, match="in fault"):
        rig.start()


@pytest.mark.parametrize("cycles", [0, 3, 6, 9])
def test_a_cable_servo_whose_supply_sags_stops_more_slowly_as_it_is_weak(cycles):
    rig = moving()
    if cycles:
        rig.run(0.01 * cycles)
    rig.inject("input_voltage", target=1, duration=5.0, value=4.0)
    assert rig.time_to_stop(1.0) < 0.130
    assert "servo 1 reports input voltage" in rig.snapshots[-1].player.message


@pytest.mark.parametrize("fault", ["vanished", "overload", "overheating"])
def test_a_cable_servo_that_releases_torque_is_a_fault_and_no_goal_is_sent_beyond(fault):
    """The servo switched its torque off itself; the driver must notice, and stop playing."""
    rig = moving()
    rig.inject(fault, target=CABLE, duration=0.3)
    rig.run(3.0, until=lambda s: s.player.phase is Phase.FAULT)
    length = rig.robot.player.length_change
    rig.run(1.0)
    assert rig.robot.player.length_change == length
    assert rig.cable.memory["torque_enable"] == 0


@pytest.mark.parametrize(
    ("fault", "arguments"),
    [
        ("no_answer", {"count": 1}),
        ("no_answer", {"target": 1, "count": 2}),
        ("corrupted_crc", {"count": 1}),
        ("truncated", {"count": 1}),
        ("duplicated", {"duration": 1.0}),
        ("error", {"count": 1, "value": 3}),
        ("late", {"count": 1, "value": 0.012}),
        ("i2c_nack", {"duration": 0.5}),  # the gait continues without the power sensor
    ],
)
def test_a_passing_disturbance_does_not_stop_the_gait_nor_falsify_a_sample(fault, arguments):
    rig = moving()
    begin = len(rig.snapshots)
    rig.inject(fault, **arguments)
    rig.run(0.5)
    assert rig.robot.player.phase is Phase.RUNNING
    check_samples(rig, begin)


@pytest.mark.parametrize("value", [0.006, 0.0095, 0.02, 0.1])
def test_a_late_answer_never_gives_an_old_value_a_new_stamp(value):
    rig = moving()
    begin = len(rig.snapshots)
    rig.inject("late", duration=0.3, value=value)
    rig.run(1.0)
    check_samples(rig, begin)
    assert rig.bus.counters.timeouts + rig.bus.counters.stale > 0


def check_samples(rig: Rig, begin: int) -> None:
    """Assert that every sample is the shaft's position at its stamp: at full speed 10 ms are 45 ticks, 2 ms are 9."""
    truth = dict(rig.positions)
    home = rig.home_ticks
    for snapshot in rig.snapshots[begin:]:
        state = snapshot.servos[0]
        if state is SILENT:
            continue
        near = [truth[t] for t in truth if abs(t - snapshot.read_time) < 0.0035]
        assert min(near) - 3 <= state.ticks + home <= max(near) + 3, snapshot.read_time


def test_an_unplugged_port_is_a_fault_that_stays_until_the_next_configuration():
    rig = moving()
    rig.wire.unplugged = True
    snapshot = rig.run(0.05)
    assert snapshot.player.phase is Phase.FAULT
    assert "is gone" in snapshot.player.message
    assert all(state is SILENT for state in snapshot.servos)
    assert math.isnan(snapshot.cable)
    rig.wire.unplugged = False
    assert rig.run(0.1).player.phase is Phase.FAULT
    # the servo received no packet for 80 ms and has stopped by itself
    assert rig.time_to_stop(0.5) < STOP


def test_without_the_driver_the_watchdog_stops_the_servo():
    rig = moving()
    died = rig.clock.now
    rig.speeds.clear()
    rig.advance(died + 1.0)
    last = max(time for time, speed in rig.speeds if speed > 0.002)
    assert last - died < STOP
    assert rig.cable.memory["bus_watchdog"] == -1


@pytest.mark.parametrize("make", [idle, moving])
def test_a_driver_that_was_suspended_finds_the_watchdog_expired_and_does_not_go_on(make):
    rig = make()
    rig.advance(rig.clock.now + 1.0)
    rig.clock.now += 1.0
    player = rig.run(0.1).player
    assert player.phase is Phase.FAULT
    assert re.search(r"began no cycle for 10\d\d ms.*load \d", player.message)
    assert "servo 1" not in player.message
    assert rig.time_to_stop(0.5) < STOP


# --- turn count -----------------------------------------------------------------------------------


def restart_cable_servo(rig: Rig) -> None:
    rig.inject("vanished", target=CABLE, duration=0.1)
    rig.run(1.0)


@pytest.mark.parametrize("how", ["in a gait", "inactive", "by reboot"])
def test_a_cable_servo_that_restarted_is_not_moved_before_it_is_homed(how):
    rig = Rig() if how == "inactive" else moving()
    if how == "by reboot":
        rig.inject("overload", target=CABLE)
        rig.run(1.0, until=lambda s: s.player.phase is Phase.FAULT)
        rig.robot.release()
        assert rig.robot.reboot() == (CABLE,)
        rig.run(1.0)
    else:
        restart_cable_servo(rig)
        rig.robot.release()
    with pytest.raises(HomingError, match="turn count"):
        rig.robot.activate(rig.clock.now)
    assert not rig.robot.actuators.homed
    assert rig.cable.memory["torque_enable"] == 0
    rig.robot.home()
    rig.robot.activate(rig.clock.now)


def test_a_cable_servo_that_restarted_is_not_homed_in_the_fault_that_follows():
    """The fault is its silence while it boots. That it restarted is visible only after this."""
    rig = moving()
    restart_cable_servo(rig)
    assert rig.run(0.2).player.phase is Phase.FAULT
    assert rig.run(1.0).homed is False


def test_a_servo_that_restarts_while_it_is_enabled_gets_no_torque_without_its_watchdog(rig):
    rig.run(0.1)
    before_write(
        rig, CABLE, "torque_enable", lambda: rig.inject("vanished", target=CABLE, duration=0.02)
    )
    with pytest.raises(ConfigurationError, match="servo 1 restarted while it was set up"):
        rig.robot.activate(rig.clock.now)
    assert rig.torques == [0, 0, 0]
    with pytest.raises(HomingError):
        rig.robot.activate(rig.clock.now)


def test_a_restart_between_two_drivers_is_noticed():
    rig = Rig(settings(home_at_start=False))
    assert not rig.robot.actuators.homed
    rig.robot.home()
    assert rig.restarted_driver().robot.actuators.homed
    restart_cable_servo(rig)
    assert not rig.restarted_driver().robot.actuators.homed


def test_a_position_that_jumps_by_a_turn_is_a_fault():
    rig = moving()
    rig.run(1.0, until=lambda s: s.cable < -0.06)
    rig.cable._fold()
    snapshot = rig.run(0.02)
    assert snapshot.player.phase is Phase.FAULT
    assert re.search("servo 1 jumped by -40.. ticks", snapshot.player.message)
    before = rig.cable.shaft.position
    assert rig.time_to_stop(1.0) < STOP
    assert abs(rig.cable.shaft.position - before) < 250


def test_a_body_that_springs_back_is_held_where_it_has_come_to_by_then():
    rig = moving()
    rig.robot.release()
    rig.run(0.05)
    # when servo 1 has returned its position, and has no torque yet
    before_write(rig, 12, "bus_watchdog", lambda: rig.inject("no_answer", target=12, count=4))
    rig.robot.activate(rig.clock.now)
    held = rig.cable.shaft.position
    rig.positions.clear()
    rig.run(0.3)
    assert max(abs(position - held) for _, position in rig.positions) < 26  # it yields by 1 mm


def test_homing_and_a_reboot_with_the_torque_on_are_rejected():
    rig = idle()
    with pytest.raises(HomingError, match="deactivate"):
        rig.robot.home()
    with pytest.raises(ConfigurationError, match="deactivate"):
        rig.robot.reboot()


def test_a_cable_out_of_its_range_is_not_moved(rig):
    servo = rig.cable
    servo.motor = servo.motor._replace(position=servo.motor.position - 1000)  # 24 mm of slack
    rig.run(0.1)
    with pytest.raises(HomingError, match="mm from its initial length"):
        rig.robot.activate(rig.clock.now)


# --- alerts and reboot ----------------------------------------------------------------------------


def test_an_alert_is_ended_by_a_reboot_on_request_only():
    rig = moving()
    rig.inject("overload", target=12)
    rig.run(1.0, until=lambda s: s.player.phase is Phase.FAULT)
    rig.robot.release()
    rig.run(0.5)
    assert rig.snapshots[-1].alerts == {12}
    with pytest.raises(ConfigurationError, match=r"servo 12 reports overload: .* reboot"):
        rig.robot.activate(rig.clock.now)
    assert rig.robot.reboot() == (12,)
    rig.run(1.0)
    assert rig.snapshots[-1].alerts == frozenset()
    rig.robot.activate(rig.clock.now)


# --- other robots ---------------------------------------------------------------------------------


@pytest.mark.parametrize(("model", "raw"), [(XL330_M288, 1750), (XM430_W350, 1193)])
def test_no_limit_of_the_output_is_above_the_maximum_of_the_model(model, raw):
    rig = rig_of_model(model, max_servo_current=5.0)
    rig.activate()
    assert rig.cable.memory["current_limit"] == raw


@pytest.mark.parametrize(
    ("model", "limits", "register", "raw"),
    [
        (XL330_M288, {"max_servo_current": 1.0}, "current_limit", 1100),  # 1 mA
        (XL430_W250, {"max_servo_load": 0.6}, "goal_pwm", 584),  # 0.113 %
        (XM430_W350, {"max_servo_current": 1.5}, "current_limit", 613),  # 2.69 mA
    ],
)
def test_each_model_limits_its_output_a_little_above_the_level_of_a_fault(
    model, limits, register, raw
):
    """The cable is blocked. Only the servo's effort may show this, in time before the servo overheats."""
    rig = rig_of_model(model, **limits, max_following_error=1.0).play(0.02, 0.2, cycles=2)
    assert rig.cable.memory[register] == raw
    rig.run(1.0)
    rig.inject("stalled", target=CABLE, duration=10.0)
    fault = rig.run(1.0, until=lambda s: s.player.phase is Phase.FAULT)
    assert "servo 1 is beyond its limit" in fault.player.message
    assert not rig.cable.memory["hardware_error_status"]


# --- gaits with pretension, share and profile -------------------------------------------------------

SHAPED = {"pretension": 0.012, "contraction_share": 0.6, "profile": 1, "ramp_share": 0.2}


@pytest.mark.parametrize("waveform", [{"pretension": 0.0}, SHAPED], ids=["paper", "shaped"])
def test_a_gait_is_played_as_commanded_and_ends_released(waveform):
    """The speeds of all gaits are in test_gait_player.py."""
    rig, pretension = idle(), waveform["pretension"]
    rig.goals.clear()
    rig.play(0.06, 0.4, 2, **waveform)
    assert rig.snapshots[-1].cable == pytest.approx(-pretension, abs=1e-3)
    end = rig.run(20.0, until=lambda s: s.player.run.ending is not None)
    run = end.player.run
    assert run.ending is Ending.COMPLETED
    assert end.commanded == -pretension
    rig.run(5.0, until=lambda s: s.player.phase is Phase.IDLE)
    rig.run(0.3)
    assert rig.snapshots[-1].cable == pytest.approx(0.0, abs=5e-4)
    spool = rig.settings.spools[0]
    goals = [spool.length_change(goal.ticks) for goal in rig.goals if goal.servo == CABLE]
    assert (min(goals), max(goals)) == pytest.approx((-0.06 - pretension, 0.0), abs=1e-4)
    played = [s for s in rig.snapshots if run.onset <= s.command_time < run.end]
    assert len(played) >= 490
    wanted = [run.gait.length_change(snapshot.command_time - run.onset) for snapshot in played]
    assert [snapshot.commanded for snapshot in played] == pytest.approx(wanted, abs=1e-9)
    cable = [snapshot.cable for snapshot in played]
    assert cable == pytest.approx(wanted, abs=6e-3)
    assert -0.06 < min(cable) + pretension < -0.057  # the servo yields to the load


def test_a_lower_limit_ends_a_gait_whose_pretension_and_stroke_exceed_it():
    rig = idle().play(0.06, 0.4, 5, **SHAPED)
    assert "run 1 ends" in rig.robot.apply_settings(
        rig.clock.now, replace(rig.settings, max_stroke=0.07)
    )
    rig.run(10.0, until=lambda s: s.player.phase is Phase.IDLE)
    assert rig.robot.player.run.ending is Ending.CANCELLED
    with pytest.raises(RejectedError, match="contract the body by"):
        rig.start(0.06, 0.4, 5, **SHAPED)


def test_a_blocked_fin_is_named():
    rig = idle()
    rig.inject("stalled", target=12, duration=60.0)
    rig.start(0.03, 0.4, cycles=1, direction=-1)
    fault = rig.run(10.0, until=lambda s: s.player.phase is Phase.FAULT).player.message
    assert "did not reach" in fault or "servo 12 reports overload" in fault
    assert "servo 12" in fault
    assert "servo 11" not in fault
