# SPDX-License-Identifier: Apache-2.0
"""The twin node as a process: it publishes the core's results for the same messages."""

import math
from pathlib import Path

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from harness import LATCHED, NAMESPACE, Probe, Processes
from nav_msgs.msg import Odometry
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from visualization_msgs.msg import MarkerArray

from worm_model.gait import Gait
from worm_model.nodes import twin_messages as ros_twin
from worm_model.parameters import PAPER
from worm_model.twin.data.samples import SAMPLE
from worm_model.twin.twin import Output, Twin
from worm_msgs.msg import (
    BodyLength,
    GaitState,
    Power,
    Tracker,
    TwinResiduals,
    TwinState,
)
from worm_msgs.msg import Gait as GaitMessage

try:
    from tf2_msgs.msg import TFMessage
except ModuleNotFoundError:  # it is not a wheel
    TFMessage = None

GAIT = Gait(0.07, 0.4)
MESSAGE = GaitMessage(stroke=GAIT.stroke, frequency=GAIT.frequency, direction=1)
ONSET = 1_700_000_000_000_000_000
BEHIND = 47  # number of samples at 100 Hz by which the twin's states lag behind the newest


class Robot:
    """Publisher of a robot's topics, with stamps of its own."""

    def __init__(self, probe: Probe) -> None:
        node = probe.node
        self.probe = probe
        self.diagnostics = probe.collect(DiagnosticArray, "/diagnostics")
        self.sent: list[tuple[str, object]] = []
        self.publishers = {
            topic: node.create_publisher(kind, topic, LATCHED if topic == "gait_state" else 1000)
            for topic, (kind, _) in ros_twin.INPUTS.items()
        }
        probe.wait_for(
            lambda: all(p.get_subscription_count() for p in self.publishers.values()), "twin"
        )

    def send(self, topic: str, time: float, message: object) -> None:
        message.header.stamp = ros_twin.time_message(ONSET + round(time * 1e9))
        self.sent.append((topic, message))
        self.publishers[topic].publish(message)

    def wait_until_received(self) -> None:
        """Wait until the twin has counted all samples that were sent."""
        self.probe.wait_for(
            lambda: samples_counted(self.diagnostics) >= len(self.sent), "word of all samples"
        )

    def announce(self, time: float, state: int) -> None:
        onset = ONSET if state == GaitState.RUNNING else 0
        message = GaitState(state=state, gait=MESSAGE, onset=ros_twin.time_message(onset))
        self.send("gait_state", time, message)

    def move(self, time: float) -> None:
        command = GAIT.command(time) if time > 0 else 0.0
        length = BodyLength(source=BodyLength.COMMANDED, length_change=command)
        self.send("body_length/commanded", time, length)
        self.send("power", time, Power(status=Power.VALID, power=1.0))
        # The mean of any number of these is exact, regardless of how many have arrived when the run begins.
        self.send("tracker", time, Tracker(rear_position=0.25, front_position=math.nan))


def samples_counted(diagnostics: list) -> int:
    values = [v for m in diagnostics[-1:] for s in m.status for v in s.values]
    return sum(int(v.value) for v in values if v.key.startswith("samples_"))


def play(robot: Robot, probe: Probe, states: list, end: float = 2.0) -> None:
    """Publish a rest and part of a cycle at 100 Hz, as fast as the twin follows.

    The publisher never leads by more than the twin's delay: a topic that arrives after another would be late.
    """
    robot.announce(-1.0, GaitState.RESTING)
    for k in range(-100, round(100 * end) + 1):
        if k == 0:
            robot.announce(0.0, GaitState.RUNNING)
        robot.move(k / 100)
        if k % 20 == 0 and k < -50:
            robot.wait_until_received()  # no state is published yet
        if k % 10 == 0 and k > -50:
            stamp = ONSET + round((k - BEHIND) * 1e7)
            probe.wait_for(lambda s=stamp: reached(states, s), f"state at {k / 100} s")


def reached(states: list, stamp: int) -> bool:
    return bool(states) and ros_twin.nanoseconds(states[-1].header.stamp) >= stamp


def offline(sent: list) -> Output:
    twin = Twin()
    rows = [ros_twin.INPUTS[topic][1](message) for topic, message in sent]
    return twin.advance(twin.start(), np.array(rows, SAMPLE))


def numbers(message: TwinResiduals) -> str:
    """Return the numbers as text, in which NaN equals itself; the health depends on the order of equal stamps."""
    found = (message.header.stamp, message.rear_position, message.power, message.energy)
    return repr(found)


def test_live_equals_offline_and_ctrl_c_is_clean(processes: Processes, probe: Probe):
    states = probe.collect(TwinState, "twin/state")
    residuals = probe.collect(TwinResiduals, "twin/residuals")
    lengths = probe.collect(BodyLength, "body_length/estimated")
    diagnostics = probe.collect(DiagnosticArray, "/diagnostics")
    odometry = probe.collect(Odometry, "twin/odometry")
    process = processes.start_node("worm_model", "twin_node")
    robot = Robot(probe)
    play(robot, probe, states)
    expected = offline(robot.sent)
    probe.wait_for(lambda: len(states) >= len(expected.states), "all states")
    probe.wait_for(lambda: len(residuals) >= len(expected.residuals), "all residuals")
    # as text, in which NaN equals itself
    shown = [repr(ros_twin.state_message(row)) for row in expected.states]
    assert [repr(state) for state in states] == shown
    assert lengths == [ros_twin.length_message(row) for row in expected.lengths]
    assert {numbers(m) for m in residuals} == {
        numbers(ros_twin.residuals_message(row, expected.warnings)) for row in expected.residuals
    }
    probe.wait_for(lambda: odometry[-1].header.stamp == states[-1].header.stamp, "last odometry")
    positions = {repr(state.header.stamp): state.rear_position for state in states}
    for message in odometry:
        assert (message.header.frame_id, message.child_frame_id) == ("odom", "base_link")
        assert message.pose.pose.position.x == positions[repr(message.header.stamp)]
    status = probe.wait_for(
        lambda: [s for m in diagnostics for s in m.status if s.name == "worm/twin: model"],
        "diagnostics",
    )
    assert {v.key: v.value for v in status[-1].values}["samples_late"] == "0"
    process.interrupt()
    assert process.wait(10.0) == 0
    assert "Traceback" not in process.output()


def set_parameter(probe: Probe, name: str, value: object) -> bool:
    message = Parameter(name, value=value).to_parameter_msg()
    request = SetParameters.Request(parameters=[message])
    return (
        probe.call(SetParameters, f"{NAMESPACE}/twin/set_parameters", request).results[0].successful
    )


def check_transforms(robot: Robot, odometry: list, frames: list) -> None:
    """Check that the node publishes the transform of its odometry, until a parameter forbids it."""
    probe = robot.probe
    (sent,) = probe.wait_for(lambda: frames and frames[-1].transforms, "a transform")
    assert (sent.header.frame_id, sent.child_frame_id) == ("odom", "base_link")
    assert sent.transform.translation.x in [m.pose.pose.position.x for m in odometry]
    assert set_parameter(probe, "publish_tf", False)
    frames.clear()
    before = len(odometry)
    robot.move(1.22)
    probe.wait_for(lambda: len(odometry) > before, "odometry without the transform")
    assert frames == []


def test_it_takes_new_parameters_and_shows(processes: Processes, probe: Probe, tmp_path: Path):
    states = probe.collect(TwinState, "twin/state")
    markers = probe.collect(MarkerArray, "twin/markers")
    odometry = probe.collect(Odometry, "twin/odometry")
    frames = probe.collect(TFMessage, "tf") if TFMessage else []
    processes.start_node("worm_model", "twin_node")
    robot = Robot(probe)
    play(robot, probe, states, end=0.9)
    file = tmp_path / "other.yaml"
    file.write_text("idle_power: 5.0\n")
    assert set_parameter(probe, "parameter_file", str(file))
    before = len(states)
    for k in range(91, 121):
        robot.move(k / 100)
    probe.wait_for(lambda: reached(states, ONSET + 600_000_000), "states after the change")
    last, first = states[before - 1 : before + 1]
    assert first.power - last.power == pytest.approx(5.0 - PAPER.idle_power, abs=1.0)
    spent = 0.5 * (last.power + first.power) * 0.01  # from one sample to the next
    assert first.energy == pytest.approx(last.energy + spent, abs=0.01)

    shown = probe.wait_for(lambda: markers, "markers")[-1]
    assert {"pipe ridges", "twin rear module", "rear fins"} <= {m.ns for m in shown.markers}
    # Without input the command reports that, and draws nothing of the past.
    diagnostics = probe.collect(DiagnosticArray, "/diagnostics")
    status = probe.wait_for(
        lambda: [s for m in diagnostics for s in m.status if "no input for" in s.message], "a word"
    )
    assert status[0].level == DiagnosticStatus.WARN
    markers.clear()
    mark = len(diagnostics)
    probe.wait_for(lambda: len(diagnostics) > mark + 1, "another second")
    assert markers == []
    assert not set_parameter(probe, "delay_s", -1.0)
    assert not set_parameter(probe, "parameter_file", "/nowhere.yaml")
    assert set_parameter(probe, "power_scale_w", 2.0)
    before = len(states)
    robot.move(1.21)
    probe.wait_for(lambda: len(states) > before, "a state after the change")
    if TFMessage:
        check_transforms(robot, odometry, frames)
