# SPDX-License-Identifier: Apache-2.0
"""The terminal view as a process, with a twin that stops publishing."""

import signal

from harness import Probe, Processes

from worm_msgs.msg import BodyLength, Power, Tracker, TwinResiduals, TwinState

NAN = float("nan")


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

    def shows(text: str, *, x1: float = NAN, live: bool = False) -> bool:
        command.publish(BodyLength())
        power.publish(Power(power=2.5))
        if live:
            twin.publish(TwinState(rear_position=0.1, front_position=0.3943, power=3.0))
            health.publish(TwinResiduals(health=TwinResiduals.HEALTHY))
        if x1 == x1:
            tracker.publish(Tracker(rear_position=x1, front_position=x1 + 0.2943))
        return text in screen(watch.output())

    probe.wait_for(lambda: shows("110.00", x1=0.11), "the robot's position without a twin")
    alone = screen(watch.output())
    assert "(no twin)" in alone
    assert "2.50 W" in alone
    probe.wait_for(lambda: shows("twin  healthy", x1=0.12, live=True), "the twin's health")
    probe.wait_for(lambda: shows("20.00", x1=0.12, live=True), "the difference")
    assert "silent" not in screen(watch.output())
    probe.wait_for(lambda: shows("twin silent for", x1=0.13), "a message that the twin is silent")
    probe.wait_for(lambda: shows("130.00", x1=0.13), "the robot's newest position")
    stale = screen(watch.output())
    assert "driver silent" not in stale
    assert "tracker silent" not in stale
    assert "twin  unknown" in stale
    assert "100.00" not in stale
    probe.wait_for(lambda: shows("tracker silent for"), "a message that the tracker is silent")
    assert "130.00" not in screen(watch.output())
    watch.signal(signal.SIGTERM)
    assert watch.wait(10.0) == 0
    assert "Traceback" not in watch.output()
