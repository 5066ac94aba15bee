# SPDX-License-Identifier: Apache-2.0
"""The twin node as a process that follows a played bag: it publishes the core's results for the same messages."""

import math
from pathlib import Path

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from harness import TIMEOUT_S, Probe, Processes
from nav_msgs.msg import Odometry
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from recorded_run import simulated_run, write_bag
from visualization_msgs.msg import MarkerArray

from worm_model.nodes.twin_messages import nanoseconds
from worm_model.parameters import PAPER
from worm_model.twin.offline_replay import replay_run
from worm_msgs.msg import BodyLength, TwinResiduals, TwinState
from worm_optimizer.operation.processes import Process

try:
    from tf2_msgs.msg import TFMessage
except ModuleNotFoundError:  # it is not a wheel
    TFMessage = None

RUN = simulated_run()


def start(processes: Processes, folder: Path, rate: str) -> tuple[Process, Process]:
    """Start a player of `RUN` and a twin that follows it, and return both."""
    bag = write_bag(folder / "bag", RUN)
    player = processes.start_node("worm_model", "play", str(bag), "--rate", rate, "--twin")
    return player, processes.start_node("worm_model", "twin_node", use_sim_time=True)


def by_stamp(messages: list) -> dict:
    return {nanoseconds(message.header.stamp): message for message in messages}


def finite(stamps: list[int], values: list[float]) -> dict[int, float]:
    return {stamp: v for stamp, v in zip(stamps, values, strict=True) if math.isfinite(v)}


def test_the_live_twin_yields_what_the_offline_replay_yields_and_ctrl_c_is_clean(
    processes: Processes, probe: Probe, tmp_path: Path
):
    states = probe.collect(TwinState, "twin/state", 10_000)
    residuals = probe.collect(TwinResiduals, "twin/residuals", 10_000)
    lengths = probe.collect(BodyLength, "body_length/estimated", 10_000)
    odometry = probe.collect(Odometry, "twin/odometry")
    diagnostics = probe.collect(DiagnosticArray, "/diagnostics")
    player, twin = start(processes, tmp_path, "2")
    probe.wait_for(lambda: player.exit_code is not None, "end of the bag")
    offline = replay_run(RUN, PAPER)
    last = int(offline.states["stamp_ns"][-1])
    behind = 500_000_000  # ns, the largest delay of a live twin; the bag's time ends with the bag
    probe.wait_for(
        lambda: states and nanoseconds(states[-1].header.stamp) >= last - behind, "the last states"
    )
    probe.wait_for(lambda: odometry[-1].header.stamp == states[-1].header.stamp, "last odometry")
    twin.interrupt()
    assert twin.wait(TIMEOUT_S) == 0
    assert "Traceback" not in twin.output()
    for messages, columns in ((states, offline.states), (residuals, offline.residuals)):
        came, shown = len(messages), messages[0].get_fields_and_field_types().keys()
        stamps = [nanoseconds(message.header.stamp) for message in messages]
        assert stamps == columns["stamp_ns"][:came].tolist()
        for name in columns.keys() & shown - {"health"}:  # depends on the order of equal stamps
            live = finite(stamps, [getattr(message, name) for message in messages])
            expected = finite(stamps, columns[name][:came].tolist())
            assert live == pytest.approx(expected, rel=1e-9, abs=1e-12), name
    published = by_stamp(states)
    assert {message.source for message in lengths} == {BodyLength.ESTIMATED}
    estimated = by_stamp(lengths)
    measured = np.interp([*estimated], offline.states["stamp_ns"], offline.states["length"])
    assert [message.length for message in estimated.values()] == pytest.approx(measured, abs=1e-3)
    for stamp, message in by_stamp(odometry).items():
        assert (message.header.frame_id, message.child_frame_id) == ("odom", "base_link")
        assert message.pose.pose.position.x == published[stamp].rear_position
    (status,) = [s for m in diagnostics[-1:] for s in m.status if s.name == "worm/twin: model"]
    assert {v.key: v.value for v in status.values}["samples_late"] == "0"


def set_parameter(probe: Probe, name: str, value: object) -> bool:
    message = Parameter(name, value=value).to_parameter_msg()
    request = SetParameters.Request(parameters=[message])
    return probe.call(SetParameters, "twin/set_parameters", request).results[0].successful


def check_transforms(probe: Probe, odometry: list, frames: list) -> None:
    """Check that the node publishes the transform of its odometry, until a parameter forbids it."""
    (sent,) = probe.wait_for(lambda: frames and frames[-1].transforms, "a transform")
    assert (sent.header.frame_id, sent.child_frame_id) == ("odom", "base_link")
    assert sent.transform.translation.x in [m.pose.pose.position.x for m in odometry]
    assert set_parameter(probe, "publish_tf", False)
    for check in (lambda: None, lambda: frames == []):  # the first one may still be on its way
        before = len(odometry)
        probe.wait_for(lambda n=before: len(odometry) > n + 1, "odometry without the transform")
        assert check() is not False
        frames.clear()


def test_it_takes_new_parameters_and_shows(processes: Processes, probe: Probe, tmp_path: Path):
    states = probe.collect(TwinState, "twin/state", 10_000)
    markers = probe.collect(MarkerArray, "twin/markers")
    odometry = probe.collect(Odometry, "twin/odometry")
    frames = probe.collect(TFMessage, "tf") if TFMessage else []
    diagnostics = probe.collect(DiagnosticArray, "/diagnostics")
    player, _ = start(processes, tmp_path, "0.05")
    file = tmp_path / "other.yaml"
    file.write_text("idle_power: 5.0\n")
    probe.wait_for(lambda: len(states) > 10, "states")
    assert set_parameter(probe, "parameter_file", str(file))
    change = probe.wait_for(
        lambda: next((k for k, s in enumerate(states) if s.power > 4.0), None), "change"
    )
    last, first = states[change - 1 : change + 1]
    assert first.power - last.power == pytest.approx(5.0 - PAPER.idle_power, abs=1.0)
    passed = 1e-9 * (nanoseconds(first.header.stamp) - nanoseconds(last.header.stamp))
    assert last.power * passed < first.energy - last.energy < first.power * passed
    assert not set_parameter(probe, "delay_s", -1.0)
    assert not set_parameter(probe, "parameter_file", "/nowhere.yaml")
    assert set_parameter(probe, "power_scale_w", 2.0)
    before = len(states)
    probe.wait_for(lambda: len(states) > before, "a state after the change")
    if TFMessage:
        check_transforms(probe, odometry, frames)
    shown = probe.wait_for(lambda: markers, "markers")[-1]
    assert {"pipe ridges", "twin rear module", "rear fins"} <= {m.ns for m in shown.markers}

    # Without input the node reports that, and draws nothing of the past.
    player.interrupt()
    diagnostics.clear()
    status = probe.wait_for(
        lambda: [s for m in diagnostics for s in m.status if "no input for" in s.message], "a word"
    )
    assert status[0].level == DiagnosticStatus.WARN

    def nothing_is_drawn() -> bool:
        markers.clear()  # also those that were drawn before and arrive late
        mark = len(diagnostics)
        probe.wait_for(lambda: len(diagnostics) > mark + 1, "another second")
        return not markers

    probe.wait_for(nothing_is_drawn, "second without markers")
