# SPDX-License-Identifier: Apache-2.0
"""The main job: a gait request, motion, a bag, its replay; and a demo that is interrupted."""

import json
import signal
from pathlib import Path

import pytest
from harness import TIMEOUT_S, Processes
from rosbags.highlevel import AnyReader

DEMO_TIMEOUT_S = 600.0  # the first front on a machine takes a minute, the gait half of one
TOPICS = {
    "/worm/joint_states": "sensor_msgs/msg/JointState",
    **{
        f"/worm/body_length/{source}": "worm_msgs/msg/BodyLength"
        for source in ("commanded", "cable", "estimated", "measured")
    },
    "/worm/power": "worm_msgs/msg/Power",
    "/worm/tracker": "worm_msgs/msg/Tracker",
    "/worm/gait_state": "worm_msgs/msg/GaitState",
    "/worm/twin/state": "worm_msgs/msg/TwinState",
    "/worm/twin/residuals": "worm_msgs/msg/TwinResiduals",
    "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
}

# one process runs all, so that they share one demo
pytestmark = [pytest.mark.timeout(300), pytest.mark.xdist_group("demo")]


def processes_with(text: str) -> list[str]:
    """Return the command lines of the running processes that contain a text."""
    lines = []
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            arguments = path.read_bytes().split(b"\0")
        except OSError:
            continue  # the process has just ended
        line = b" ".join(arguments).decode(errors="replace")
        if text in line:
            lines.append(line)
    return lines


@pytest.fixture(scope="module")
def demo(tmp_path_factory, module_domain):
    """Result of one finished demo: its JSON output and its log."""
    folder = tmp_path_factory.mktemp("demo")
    with Processes(folder) as group:
        demo = group.start_executable(
            "worm_optimizer", "demo", "--bags", str(folder / "bags"), "--json"
        )
        code = demo.wait(DEMO_TIMEOUT_S)
        assert code == 0, demo.output()
    return json.loads(demo.output().splitlines()[-1])


def test_predictions_and_measurements_agree_and_nothing_keeps_running(demo):
    measured = demo["measured"]
    assert measured["speed"] == pytest.approx(demo["gait"]["nominal_speed"], rel=0.05)
    for source in ("twin", "predicted"):
        assert demo[source]["speed"] == pytest.approx(measured["speed"], rel=0.05)
        assert demo[source]["power"] == pytest.approx(measured["power"], rel=0.15)
        # both are computed independently: the last digits differ
        assert demo[source]["power"] != measured["power"]
    assert demo["robust"]["power"] == demo["gait"]["power"]
    assert Path(demo["figure"]).read_bytes().startswith(b"\x89PNG\r\n")
    assert processes_with(demo["bag"]) == []


def test_an_independent_reader_reads_the_bag(demo):
    with AnyReader([Path(demo["bag"])]) as reader:
        assert TOPICS.items() <= {c.topic: c.msgtype for c in reader.connections}.items()

        def messages(topic: str) -> list:
            connections = [c for c in reader.connections if c.topic == topic]
            read = reader.messages(connections)
            return [reader.deserialize(data, connection.msgtype) for connection, _, data in read]

        tracker, states = messages("/worm/tracker"), messages("/worm/gait_state")
    assert len(tracker) > 500
    assert tracker[-1].rear_position - tracker[0].rear_position > 0.1
    gaits = {(s.gait.stroke, s.gait.frequency) for s in states if s.state == 3}
    assert gaits == {(demo["gait"]["stroke"], demo["gait"]["frequency"])}
    assert max(s.cycle for s in states) == 5


@pytest.mark.night
def test_an_interrupted_demo_leaves_no_process_and_a_whole_bag(processes, tmp_path):
    """The signal is SIGTERM, which is handled like Ctrl-C with one more step (termination_as_interrupt)."""
    bags = tmp_path / "bags"
    demo = processes.start_executable("worm_optimizer", "demo", "--bags", str(bags))
    demo.wait_for_line("cycle 1,", DEMO_TIMEOUT_S)
    assert len(processes_with(str(bags))) > 1
    demo.signal(signal.SIGTERM)
    assert demo.wait(TIMEOUT_S) == 1
    assert "cancelled" in demo.last_line()
    assert processes_with(str(bags)) == []
    (bag,) = bags.iterdir()
    with AnyReader([bag]) as reader:
        assert reader.message_count > 100


def test_a_failed_stage_is_reported_in_one_line(processes, tmp_path):
    plant = tmp_path / "plant.yaml"
    plant.write_text("no_such_key: 1\n")
    demo = processes.start_executable(
        "worm_optimizer", "demo", "--bags", str(tmp_path / "bags"), "--plant", str(plant)
    )
    assert demo.wait(TIMEOUT_S) == 1
    assert "Traceback" not in demo.output()
    assert "virtual_robot ended with exit status" in demo.last_line()
    assert "no_such_key" in demo.last_line()
