# SPDX-License-Identifier: Apache-2.0
"""The terminal view as a process, with a twin that stops publishing."""

import signal

import pytest
from harness import Probe, Processes

pytest.importorskip("rclpy", reason="no ROS is installed")

from worm_msgs.msg import BodyLength, Power, Tracker, TwinResiduals, TwinState


def screen(output: str) -> str:
    """Return the screen that was drawn last, when it is complete."""
    return output.split("\033[H\033[J")[-2] if output.count("\033[H\033[J") > 1 else ""


def test_it_shows_new_messages_and_reports_when_they_stop(processes: Processes, probe: Probe):
    node = probe.node
    twin = node.create_publisher(TwinState, "twin/state", 10)
    health = node.create_publisher(TwinResiduals, "twin/residuals", 10)
    tracker = node.create_publisher(Tracker, "tracker", 10)
    power = node.create_publisher(Power, "power", 10)
    command = node.create_publisher(BodyLength, "body_length/commanded", 10)
    watch = processes.start_node("worm_model", "watch")

    def shows(text: str, *, live: bool) -> bool:
        command.publish(BodyLength())
        power.publish(Power(power=2.5))
        if live:
            twin.publish(TwinState(rear_position=0.1, front_position=0.3943, power=3.0))
            health.publish(TwinResiduals(health=TwinResiduals.HEALTHY))
            tracker.publish(Tracker(rear_position=0.12, front_position=0.4143))
        return text in screen(watch.output())

    probe.wait_for(lambda: shows("120.00", live=True), "the robot's position")
    assert "twin  healthy" in screen(watch.output())
    assert "silent" not in screen(watch.output())
    probe.wait_for(lambda: shows("twin silent for", live=False), "word of the silence")
    stale = screen(watch.output())
    assert "tracker silent for" in stale
    assert "driver silent" not in stale
    assert "twin  unknown" in stale
    assert "120.00" not in stale
    watch.signal(signal.SIGTERM)
    assert watch.wait(10.0) == 0
    assert "Traceback" not in watch.output()
