# SPDX-License-Identifier: Apache-2.0
"""worm.launch.py under launch of ROS, with virtual robots.

The tests are skipped where launch is not installed (it is not a wheel).
"""

import os
import re
import runpy
import shutil
import signal
from collections import defaultdict
from pathlib import Path

import pytest
from ament_index_python.packages import get_package_share_directory
from commander import Commander
from diagnostic_msgs.msg import DiagnosticArray
from harness import LATCHED
from lifecycle_msgs.msg import State, Transition, TransitionEvent
from lifecycle_msgs.srv import GetState

from worm_model.bags.opening import open_bag
from worm_model.bags.run_reader import read_run
from worm_msgs.action import RunGait
from worm_msgs.msg import BodyLength, Gait, GaitState, Tracker, TwinState
from worm_optimizer.operation.system import installed_system_file

pytest.importorskip("launch_ros", reason="no launch system is installed")
ROS2 = shutil.which("ros2")
pytestmark = [
    pytest.mark.skipif(ROS2 is None, reason="no ros2 command line is installed"),
    pytest.mark.timeout(900),
]

START_S = 240.0  # of six processes, also while others compute; a virtual robot is slow then
GAIT = RunGait.Goal(
    gait=Gait(stroke=0.07, frequency=0.2, direction=Gait.FORWARD, margin=0.0), cycles=60
)
PAIR = """
from launch import LaunchDescription
from launch.actions import GroupAction, IncludeLaunchDescription
from launch_ros.actions import PushRosNamespace
from launch_ros.substitutions import FindPackageShare
from launch.substitutions import PathJoinSubstitution

def robot(name):
    path = PathJoinSubstitution([FindPackageShare("worm_optimizer"), "launch", "worm.launch.py"])
    given = {{"mode": "virtual", "namespace": name, "directory": "{folder}/" + name, "bag": ""}}
    return GroupAction([PushRosNamespace("fleet"), IncludeLaunchDescription(path, launch_arguments=given.items())])

def generate_launch_description():
    return LaunchDescription([robot("left"), robot("right")])
"""
GROUP = """
from launch import LaunchDescription
from launch.actions import GroupAction, IncludeLaunchDescription, SetEnvironmentVariable
from launch.substitutions import PathJoinSubstitution
from launch_ros.actions import SetParameter, SetRemap
from launch_ros.substitutions import FindPackageShare

def generate_launch_description():
    path = PathJoinSubstitution([FindPackageShare("worm_optimizer"), "launch", "worm.launch.py"])
    given = {{"mode": "virtual", "directory": "{folder}/robot", "bag": "{folder}/bag"}}
    return LaunchDescription([GroupAction([
        SetRemap("power", "supply"),
        SetParameter("use_sim_time", False),
        SetEnvironmentVariable("WORM_TEST", "set"),
        IncludeLaunchDescription(path, launch_arguments=given.items()),
    ])])
"""


@pytest.fixture
def launched(processes, tmp_path, monkeypatch):
    """Start worm.launch.py with arguments."""
    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path / "ros_logs"))
    monkeypatch.setenv("PYTHONUNBUFFERED", "1")
    processes._env = dict(os.environ)

    def start(
        *arguments: str,
        file: tuple[str, ...] = ("worm_optimizer", "worm.launch.py"),
        name: str = "launch",
    ):
        return processes.start(name, [ROS2, "launch", *file, *arguments])

    return start


def virtual(folder: Path, **settings: object) -> list[str]:
    given = {"mode": "virtual", "directory": folder / "robot", **settings}
    return [f"{name}:={value}" for name, value in given.items()]


def state_of(probe, name: str = "/worm/driver") -> int:
    return probe.call(GetState, f"{name}/get_state", GetState.Request(), START_S).current_state.id


def wait_for_active(probe, name: str = "/worm/driver") -> None:
    probe.wait_for(
        lambda: state_of(probe, name) == State.PRIMARY_STATE_ACTIVE, "activation", START_S
    )


def pids(output: str) -> dict[str, int]:
    found = re.findall(r"\[(\w+)-\d+\]: process started with pid \[(\d+)\]", output)
    return {name: int(number) for name, number in found}


def runs(pid: int) -> bool:
    try:
        return "\nState:\tZ" not in Path(f"/proc/{pid}/status").read_text()
    except OSError:
        return False


def test_after_one_failure_a_robot_is_its_operators(launched, probe, processes, tmp_path):
    robot = processes.start_executable(
        "worm_driver", "virtual_robot", "--directory", str(tmp_path / "robot")
    )
    robot.wait_for_line("ready:", START_S)
    launch = launched("mode:=robot", "port:=/nope", "i2c_bus:=none")
    launch.wait_for_line("cannot configure: .*/nope", START_S)
    launch.wait_for_line("waiting for configure: ", START_S)
    assert state_of(probe) == State.PRIMARY_STATE_UNCONFIGURED

    commander = Commander(probe)
    port = str(tmp_path / "robot" / "servo_bus")
    assert commander.set_parameter("port", port).successful
    assert commander.change(Transition.TRANSITION_CONFIGURE)
    reports = probe.collect(DiagnosticArray, "/diagnostics")
    probe.wait_for(
        lambda: sum(s.name == "worm/driver: gait" for r in reports for s in r.status) >= 5,
        "five seconds",
    )
    assert state_of(probe) == State.PRIMARY_STATE_INACTIVE


@pytest.mark.night
def test_launch_is_as_patient_as_a_slow_return(launched, probe, tmp_path):
    """The return from ΔL = -60 mm at 12 mm/s takes 8 s, longer than launch waits by default, and is recorded."""
    file = tmp_path / "driver.yaml"
    file.write_text("/worm/driver: {ros__parameters: {return_speed_m_per_s: 0.012}}\n")
    launch = launched(*virtual(tmp_path, driver_file=file, bag=tmp_path / "bag"))
    wait_for_active(probe)
    states = probe.collect(GaitState, "gait_state", LATCHED)
    lengths = probe.collect(BodyLength, "body_length/cable")
    goal = probe.send_goal(RunGait, "run_gait", GAIT)
    result = goal.get_result_async()
    probe.wait_for(lambda: lengths and lengths[-1].length_change < -0.06, "contraction", START_S)
    launch.interrupt()
    assert not probe.result(result, "result of the goal", START_S).result.success
    probe.wait_for(lambda: launch.exit_code is not None, "end of launch", START_S)
    assert launch.exit_code == 0
    assert "escalating" not in launch.output()
    assert "is gone" not in launch.output()
    assert abs(lengths[-1].length_change) < 0.002
    assert states[-1].state == GaitState.INACTIVE
    reported: list[str] = []
    with open_bag(tmp_path / "bag", reported.append) as bag:
        run = read_run(bag)
    assert reported == []
    assert run.gait_state.state[-1] == GaitState.INACTIVE
    assert abs(run.cable.length_change[-1]) < 0.002


@pytest.mark.night
def test_two_robots_of_one_launch_file_do_not_mix(launched, probe, tmp_path):
    """Each is under a PushRosNamespace, with its own twin."""
    file = tmp_path / "pair.launch.py"
    file.write_text(PAIR.format(folder=tmp_path))
    launch = launched(file=(str(file),))
    names = ("left", "right")
    for name in names:
        wait_for_active(probe, f"/fleet/{name}/driver")
    trackers = {name: probe.collect(Tracker, f"/fleet/{name}/tracker") for name in names}
    twins = {name: probe.collect(TwinState, f"/fleet/{name}/twin/state") for name in names}
    reports = probe.collect(DiagnosticArray, "/diagnostics")
    assert probe.send_goal(RunGait, "/fleet/left/run_gait", GAIT).accepted

    def travel(name: str) -> float:
        seen = trackers[name]
        return seen[-1].rear_position - seen[0].rear_position if seen else 0.0

    probe.wait_for(lambda: travel("left") > 0.005, "motion of the left robot", START_S)
    probe.wait_for(lambda: trackers["right"], "tracker of the right robot", START_S)
    assert abs(travel("right")) < 0.002
    probe.wait_for(lambda: twins["left"], "twin of the left robot", START_S)
    once = [
        (count, f"/fleet/{name}/{topic}")
        for name in names
        for count, topic in (
            (probe.node.count_publishers, "twin/state"),
            (probe.node.count_subscribers, "body_length/commanded"),
            (probe.node.count_publishers, "clock"),
            (probe.node.count_subscribers, "clock"),  # the twin of the robot
        )
    ]
    probe.wait_for(lambda: all(count(topic) for count, topic in once), "nodes of both", START_S)
    assert [count(topic) for count, topic in once] == [1] * len(once)
    assert probe.node.count_publishers("/clock") == probe.node.count_subscribers("/clock") == 0
    assert probe.node.count_publishers("/worm/tracker") == 0
    probe.wait_for(
        lambda: (
            {f"fleet/{n}/{part}" for n in names for part in ("driver: gait", "twin: model")}
            <= {s.name for r in reports for s in r.status}
        ),
        "diagnostics of both",
    )
    assert all(s.hardware_id for r in reports for s in r.status)
    launch.interrupt()
    assert launch.wait(START_S) == 0


@pytest.mark.night
def test_the_twin_is_missed_and_starts_again_but_the_driver_ends_all(launched, probe, tmp_path):
    launch = launched(*virtual(tmp_path))
    wait_for_active(probe)
    before = pids(launch.output())
    os.kill(before["twin"], signal.SIGKILL)
    probe.wait_for(lambda: pids(launch.output())["twin"] != before["twin"], "another twin", START_S)
    assert state_of(probe) == State.PRIMARY_STATE_ACTIVE
    os.kill(before["driver"], signal.SIGKILL)
    assert launch.wait(START_S) == 1
    assert "driver has ended with exit status -9" in launch.output()
    assert "torque may be on" not in launch.output()  # of a virtual robot
    assert not any(map(runs, pids(launch.output()).values()))


@pytest.mark.night
def test_a_second_graph_ends_before_it_publishes_or_commands_anything(launched, probe, tmp_path):
    first = launched(*virtual(tmp_path))
    wait_for_active(probe)
    seen = probe.collect(TransitionEvent, "/worm/driver/transition_event")
    second = launched(*virtual(tmp_path / "second"), name="second")
    assert second.wait(START_S) == 1
    robot = pids(first.output())["virtual_robot"]
    assert f"/worm has a virtual robot or player already, process {robot} " in second.output()
    assert not any(map(runs, pids(second.output()).values()))
    assert (seen, state_of(probe)) == ([], State.PRIMARY_STATE_ACTIVE)


@pytest.mark.night
def test_settings_of_an_including_group_reach_all_nodes(launched, probe, tmp_path):
    file = tmp_path / "group.launch.py"
    file.write_text(GROUP.format(folder=tmp_path))
    launch = launched(file=(str(file),))
    wait_for_active(probe)
    nodes = pids(launch.output())
    assert nodes.keys() >= {"virtual_robot", "recorder", "twin", "optimizer", "driver"}
    for name, pid in nodes.items():
        words = Path(f"/proc/{pid}/cmdline").read_text().split("\0")
        assert {"power:=supply", "use_sim_time:=False"} <= set(words), name
        assert "WORM_TEST=set" in Path(f"/proc/{pid}/environ").read_text().split("\0"), name
    probe.wait_for(lambda: probe.node.count_subscribers("/worm/supply") > 0, "twin", START_S)
    assert probe.node.count_publishers("/worm/supply") == 1
    assert probe.node.count_publishers("/worm/power") == 0


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["mode:=robot", "driver_file:=/nonexistent"], "/nonexistent"),
        (["mode:=simulation"], "simulation"),
        (["mode:=virtual", "slope_deg:=steep"], "slope_deg"),
    ],
)
def test_invalid_arguments_are_reported_without_a_traceback(launched, arguments, expected):
    launch = launched(*arguments)
    assert launch.wait(START_S) == 1
    assert expected in launch.output()
    assert not re.search(r"^\[\w+-\d+\].*Traceback", launch.output(), re.MULTILINE)


def test_the_pipe_hangs_on_the_frame_of_the_odometry():
    """Evaluate the nodes of view.launch.py without starting them: RViz and tf2 are not wheels."""
    from launch import LaunchContext
    from launch.utilities import perform_substitutions

    path = Path(get_package_share_directory("worm_model"), "launch", "view.launch.py")
    context = LaunchContext()
    context.launch_configurations.update({"namespace": "worm", "rviz": "false"})
    context.extend_locals({"ros_specific_arguments": defaultdict(str)})  # as in nodes that start
    pipe, *publishers = runpy.run_path(str(path))["_start"](context)
    arguments = " ".join(perform_substitutions(context, part) for part in pipe.cmd[1:])
    assert "--frame-id odom --child-frame-id pipe" in arguments
    assert len(publishers) == 2


def test_every_setting_of_the_system_file_is_an_argument(launched):
    launch = launched("--show-args")
    assert launch.wait(START_S) == 0
    for name in ("mode", "namespace", "log_level", *installed_system_file().settings):
        assert f"'{name}':" in launch.output()
