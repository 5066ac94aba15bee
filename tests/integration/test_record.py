# SPDX-License-Identifier: Apache-2.0
"""The recorder with real publishers over real DDS."""

import json
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from harness import LATCHED, Probe, Processes
from mcap.reader import make_reader
from rcl_interfaces.srv import GetParameters, ListParameters
from rclpy.duration import Duration
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rosbags.highlevel import AnyReader
from sensor_msgs.msg import Image
from std_srvs.srv import Trigger

from worm_model.bags.formats.bag_writer import new_bag
from worm_model.bags.formats.cdr import encode
from worm_model.bags.formats.message_types import topic_of
from worm_model.bags.opening import open_bag
from worm_model.bags.run_reader import read_run
from worm_msgs.msg import GaitState, Power, Tracker, TwinEvent
from worm_optimizer.operation.processes import Process, executable_command, wait_for

ACKNOWLEDGED = Duration(seconds=20)
BEST_EFFORT = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
TIMEOUT_S = 30.0


def tracker(number: int) -> Tracker:
    return Tracker(rear_position=float(number), front_position=float("nan"))


def wait_until_discovered(publisher: Publisher) -> None:
    """Wait until the publisher has discovered the recorder: both sides discover each other at different times."""
    assert wait_for(lambda: publisher.get_subscription_count() > 0, TIMEOUT_S)


def publish(publisher: Publisher, numbers: range) -> None:
    """Publish trackers and wait until the recorder has them."""
    wait_until_discovered(publisher)
    for number in numbers:
        publisher.publish(tracker(number))
    assert publisher.wait_for_all_acked(ACKNOWLEDGED)


def grown(probe: Probe, file: Path, send: Callable[[], None]) -> None:
    """Send a sample until the file grows: best-effort samples may be lost while both sides discover each other.

    Earlier samples are written first: the file has stopped growing for a while.
    """
    sizes = [-1]

    def settled() -> bool:
        sizes.append(file.stat().st_size)
        return len(sizes) > 20 and len(set(sizes[-20:])) == 1

    probe.wait_for(settled, "an end of what was sent before")
    probe.wait_for(lambda: send() or file.stat().st_size > sizes[-1], "the sample in the bag")


def recorded(bag: Path) -> list[float]:
    with open_bag(bag, lambda _: None) as reader:
        return read_run(reader).tracker.rear_position.tolist()


def test_topics_of_all_kinds_are_recorded(processes: Processes, probe: Probe, tmp_path: Path):
    states = probe.node.create_publisher(GaitState, "gait_state", LATCHED)
    states.publish(GaitState(state=GaitState.RUNNING, cycles=5))
    positions = probe.node.create_publisher(Tracker, "tracker", 1000)
    powers = probe.node.create_publisher(Power, "power", BEST_EFFORT)
    parameters = tmp_path / "robot.yaml"
    parameters.write_text("pitch: 0.0173\n")
    recorder = processes.start_node(
        "worm_model",
        "record",
        *("gait_state", "tracker", "power", "--output", str(tmp_path / "bag"), "--json"),
        *("--parameters", str(parameters), "--seed", "4", "--note", "pipe=B"),
    )
    for topic in ("gait_state", "tracker", "power"):
        recorder.wait_for_line(f"recording /worm/{topic} ", TIMEOUT_S)
    file = tmp_path / "bag" / "bag_0.mcap"
    grown(probe, file, lambda: powers.publish(Power(power=2.0)))
    publish(positions, range(500))
    recorder.interrupt()
    outcome = outcome_of(recorder)
    assert outcome["dropped"] == 0
    assert outcome["missing"] == []
    with AnyReader([tmp_path / "bag"]) as reader:  # checks type hashes, too
        counts = {c.topic: c.msgcount for c in reader.connections}
    assert counts.pop("/worm/power") >= 1
    assert counts == {"/worm/gait_state": 1, "/worm/tracker": 500}
    assert recorded(tmp_path / "bag") == [float(i) for i in range(500)]
    with (tmp_path / "bag" / "bag_0.mcap").open("rb") as stream:
        reader = make_reader(stream)
        metadata = {record.name: record.metadata for record in reader.iter_metadata()}
        attachments = {a.name: a.data for a in reader.iter_attachments()}
    assert attachments == {"parameters.yaml": parameters.read_bytes()}
    assert metadata["worm_run"]["seed"] == "4"
    assert metadata["worm_run"]["note.pipe"] == "B"


def test_all_topics_of_the_namespace_and_a_new_publisher_that_offers_less(
    processes: Processes, probe: Probe, tmp_path: Path
):
    probe.node.create_publisher(Power, "/worm1/power", 1)
    probe.node.create_publisher(Image, "camera/image", 1)
    probe.node.create_publisher(Power, "run/_action/hidden", 1)
    reliable = probe.node.create_publisher(Tracker, "tracker", 1000)
    recorder = processes.start_node("worm_model", "record", "--output", str(tmp_path / "bag"))
    recorder.wait_for_line("recording /worm/tracker ", TIMEOUT_S)
    publish(reliable, range(10))
    best_effort = probe.node.create_publisher(Tracker, "tracker", BEST_EFFORT)
    recorder.wait_for_line("/worm/tracker: messages of .* are not recorded", TIMEOUT_S)
    best_effort.publish(tracker(10))
    publish(reliable, range(10, 20))
    recorder.signal(signal.SIGTERM)
    assert recorder.wait(TIMEOUT_S) == 0
    found = recorded(tmp_path / "bag")
    assert found == [float(i) for i in range(20)]
    with open_bag(tmp_path / "bag") as bag:
        assert list(bag.topics) == ["/worm/tracker"]


def test_a_full_disk_ends_the_recording_with_a_message(
    processes: Processes, probe: Probe, tmp_path: Path
):
    """The system does not let the file grow, as on a full disk."""
    command = executable_command("worm_model", "record")
    limited = ["sh", "-c", 'ulimit -f 100; exec "$@"', "sh", *command]  # 51,200 or 102,400 bytes
    recorder = processes.start("record", [*limited, "/worm/tracker", "-o", str(tmp_path / "bag")])
    positions = probe.node.create_publisher(Tracker, "tracker", 1000)
    recorder.wait_for_line("recording /worm/tracker ", TIMEOUT_S)
    wait_until_discovered(positions)
    count = 0
    while recorder.exit_code is None:
        for number in range(count, count + 100):
            positions.publish(tracker(number))
        positions.wait_for_all_acked(Duration(seconds=1))
        count += 100
        assert count < 1_000_000
    assert recorder.exit_code == 1
    assert "could not be written" in recorder.last_line()
    assert "Traceback" not in recorder.output()
    found = recorded(tmp_path / "bag")
    assert len(found) > 100
    assert found == [float(i) for i in range(len(found))]


def outcome_of(recorder: Process) -> dict[str, Any]:
    assert recorder.wait(TIMEOUT_S) == 0
    return json.loads(next(x for x in recorder.output().splitlines() if x.startswith("{")))


def test_its_services_answer_while_it_records(processes: Processes, probe: Probe, tmp_path: Path):
    recorder = processes.start_node(
        *("worm_model", "record", "tracker", "-o", str(tmp_path / "bag"), "--json")
    )
    names = probe.call(ListParameters, "recorder/list_parameters", ListParameters.Request())
    assert "use_sim_time" in names.result.names  # as for every node
    values = GetParameters.Request(names=names.result.names)
    read = probe.call(GetParameters, "recorder/get_parameters", values).values
    assert len(read) == len(values.names) > 0
    rejected = probe.call(Trigger, "/worm/recorder/snapshot", Trigger.Request())
    assert (rejected.success, rejected.message) == (
        False,
        "there is no ring buffer: record with --snapshot S",
    )
    recorder.interrupt()
    assert outcome_of(recorder)["bags"] == [str(tmp_path / "bag")]


def test_a_second_type_of_a_recorded_topic_is_reported(
    processes: Processes, probe: Probe, tmp_path: Path
):
    positions = probe.node.create_publisher(Tracker, "tracker", 1000)
    recorder = processes.start_node("worm_model", "record", "tracker", "-o", str(tmp_path / "bag"))
    recorder.wait_for_line("recording /worm/tracker ", TIMEOUT_S)
    other = processes.start_executable(
        "worm_model", "play", str(_texts_on_tracker(tmp_path / "texts")), "--loop"
    )
    recorder.wait_for_line("/worm/tracker is also published as std_msgs/msg/String", TIMEOUT_S)
    publish(positions, range(10))
    other.interrupt()
    recorder.interrupt()
    assert recorder.wait(TIMEOUT_S) == 0
    assert recorded(tmp_path / "bag") == [float(i) for i in range(10)]


def _texts_on_tracker(path: Path) -> Path:
    with new_bag(path) as writer:
        topic = topic_of("/worm/tracker", "std_msgs/msg/String")
        for k, data in enumerate(encode(topic, 2, {}, {"data": "text"})):
            writer.write(topic, data, k * 10**9, k)
    return path


def test_the_last_seconds_are_written_when_the_twin_raises_an_alarm(
    processes: Processes, probe: Probe, tmp_path: Path
):
    positions = probe.node.create_publisher(Tracker, "tracker", 1000)
    events = probe.node.create_publisher(TwinEvent, "twin/events", LATCHED)
    recorder = processes.start_node(
        *("worm_model", "record", "tracker", "twin/events", "--snapshot", "60", "--json"),
        *("-o", str(tmp_path / "bag")),
    )
    for topic in ("tracker", "twin/events"):
        recorder.wait_for_line(f"recording /worm/{topic} ", TIMEOUT_S)
    for publisher in (positions, events):
        probe.wait_for(lambda p=publisher: p.get_subscription_count() > 0, "the recorder")
    publish(positions, range(20))
    events.publish(TwinEvent(message="a run begins"))  # a message without an alarm
    assert events.wait_for_all_acked(ACKNOWLEDGED)
    assert not list(tmp_path.glob("bag*"))
    events.publish(TwinEvent(code=TwinEvent.CABLE_SLIP, message="the cable slipped"))
    recorder.wait_for_line(
        r"the twin raises an alarm \(the cable slipped\): .*_snapshot_1", TIMEOUT_S
    )
    recorder.interrupt()
    assert outcome_of(recorder)["bags"] == [str(tmp_path / "bag_snapshot_1")]
    assert recorded(tmp_path / "bag_snapshot_1") == [float(i) for i in range(20)]


@pytest.mark.parametrize(
    "way",
    [
        "lets go",
        *(pytest.param(w, marks=pytest.mark.night) for w in ("is gone", "is not waited for")),
    ],
)
def test_it_continues_after_ctrl_c_until_the_driver_has_released_the_torque(
    processes: Processes, probe: Probe, tmp_path: Path, way: str
):
    """ros2 launch ends all processes at once, and the way to rest belongs to the recording."""
    states = probe.node.create_publisher(GaitState, "gait_state", LATCHED)
    positions = probe.node.create_publisher(Tracker, "tracker", 1000)
    options = [] if way == "is not waited for" else ["--to-rest"]
    recorder = processes.start_node(
        *("worm_model", "record", "gait_state", "tracker", "-o", str(tmp_path / "bag"), *options)
    )
    for topic in ("gait_state", "tracker"):
        recorder.wait_for_line(f"recording /worm/{topic} ", TIMEOUT_S)
    for publisher in (states, positions):
        probe.wait_for(lambda p=publisher: p.get_subscription_count() > 0, "the recorder")
    states.publish(GaitState(state=GaitState.RUNNING))
    assert states.wait_for_all_acked(ACKNOWLEDGED)
    publish(positions, range(10))
    recorder.interrupt()
    if options:
        publish(positions, range(10, 20))
    if way == "lets go":
        states.publish(GaitState(state=GaitState.INACTIVE))
    elif way == "is gone":
        probe.node.destroy_publisher(states)
    assert recorder.wait(TIMEOUT_S) == 0
    assert recorded(tmp_path / "bag") == [float(i) for i in range(20 if options else 10)]
