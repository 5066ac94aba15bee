# SPDX-License-Identifier: Apache-2.0
import math
import time

import pytest

pytest.importorskip("worm_msgs", reason="the workspace is not built")

from diagnostic_msgs.msg import DiagnosticStatus

from worm_driver.control.diagnostics import DiagnosticReport, Level
from worm_driver.control.robot import CycleSnapshot
from worm_driver.gait.gait_player import Phase, PlayedRun, PlayerState
from worm_driver.nodes import driver_messages as ros_messages
from worm_driver.nodes.driver_messages import ClockPair
from worm_driver.power.ina219 import PowerSample, SampleStatus
from worm_driver.servos.registers import XL330_M288, XL430_W250, XM430_W350, ServoModel
from worm_driver.servos.state_reader import SILENT, ServoState
from worm_msgs.gait import Gait
from worm_msgs.msg import BodyLength, GaitState, Power

CLOCKS = ClockPair(1_700_000_000_000_000_000)
RUN = PlayedRun(1, Gait(0.07, 0.2), 5, 5, rest_start=1.0, onset=2.0)


def snapshot(player: PlayerState, active: bool = True) -> CycleSnapshot:
    servos = (ServoState(0, 0.5, 0.1, 0.2, 12.0, 25.0, 1.0), SILENT)
    return CycleSnapshot(8.5, 8.501, active, player, -0.01, -0.009, servos)


def test_a_stamp_is_the_moment_of_acquisition():
    stamp = CLOCKS.stamp(12.25)
    assert (stamp.sec, stamp.nanosec) == (1_700_000_012, 250_000_000)
    assert CLOCKS.monotonic(stamp) == pytest.approx(12.25, abs=1e-6)
    pair = ClockPair.read(time.time_ns)
    stamp = pair.stamp(time.monotonic())
    assert stamp.sec + stamp.nanosec * 1e-9 == pytest.approx(time.time(), abs=0.5)


def test_a_silent_servo_has_no_numbers_but_keeps_its_place():
    models = (XM430_W350, XL330_M288)
    message = ros_messages.joint_state(
        ("cable_1", "fin_11"), models, snapshot(PlayerState()), CLOCKS
    )
    assert list(message.name) == ["cable_1", "fin_11"]
    assert message.position[0] == 0.5
    assert math.isnan(message.position[1])
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (1_700_000_008, 501_000_000)


def test_effort_is_a_torque_or_unknown():
    """From the manual of the XM430-W350: 4.1 N*m at 2.3 A."""
    state = snapshot(PlayerState())
    current = state.servos[0].effort

    def effort(*models: ServoModel) -> list[float]:
        return list(ros_messages.joint_state(("a", "b"), models, state, CLOCKS).effort)

    torque, unknown = effort(XM430_W350, XL430_W250)
    assert torque == pytest.approx(current * 4.1 / 2.3)
    assert math.isnan(unknown)
    assert effort(XL430_W250, XL430_W250) == []


def test_a_length_is_the_initial_one_and_its_change():
    message = ros_messages.body_length(BodyLength.CABLE, 1.0, -0.01, 0.2952, CLOCKS)
    assert (message.source, message.length_change) == (BodyLength.CABLE, -0.01)
    assert message.length == pytest.approx(0.2852)


@pytest.mark.parametrize("status", SampleStatus)
def test_each_status_of_a_sample_has_its_number(status):
    values = (12.0, 0.5) if status is SampleStatus.VALID else (math.nan, math.nan)
    message = ros_messages.power(PowerSample(1.0, status, *values), CLOCKS)
    assert message.status == getattr(Power, status.name)
    assert math.isnan(message.power) == (status is not SampleStatus.VALID)


def test_the_state_contains_gait_cycle_and_onset():
    player = PlayerState(phase=Phase.RUNNING, run=RUN)
    message = ros_messages.gait_state(snapshot(player), CLOCKS, emergency_stop=False)
    found = (message.gait.stroke, message.run, message.cycle, message.cycles)
    assert found == (0.07, RUN.number, 2, 5)
    assert message.onset.sec == 1_700_000_002
    inactive = ros_messages.gait_state(
        snapshot(PlayerState(), active=False), CLOCKS, emergency_stop=False
    )
    assert (inactive.state, inactive.run, inactive.gait.stroke) == (GaitState.INACTIVE, 0, 0.0)


def test_the_level_of_a_diagnostic_is_a_byte():
    """An int would be accepted, and published as a random byte."""
    reports = [DiagnosticReport(f"driver: {level.name}", level, "text") for level in Level]
    array = ros_messages.diagnostics(reports, CLOCKS.stamp(1.0), "worm")
    levels = [status.level for status in array.status]
    assert levels == [DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR]
    assert all(isinstance(level, bytes) for level in levels)
