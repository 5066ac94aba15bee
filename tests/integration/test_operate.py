# SPDX-License-Identifier: Apache-2.0
"""The command operate on a driver and a virtual robot; its death, its loss of contact, and the emergency stop."""

import json
import signal
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from commander import Commander
from harness import TIMEOUT_S, Processes
from std_msgs.msg import Bool

from worm_msgs.action import RunGait
from worm_msgs.msg import Gait, GaitState
from worm_optimizer.commands import operate
from worm_optimizer.operation.processes import Process

LONG = ("--stroke", "0.03", "--frequency", "0.4", "--cycles", "200")


# one process runs all, so that they share one robot
pytestmark = pytest.mark.xdist_group("operate")


@pytest.fixture
def ros_domain(robot, module_domain: int) -> int:
    """Let probe and processes of each test join the shared robot."""
    return module_domain


class Lab:
    """Virtual robot, its active driver, and an operator who uses commands."""

    def __init__(self, robot, processes: Processes, commander: Commander) -> None:
        self.robot, self.processes, self.probe = robot, processes, commander.probe
        self.commander = commander
        robot.start_driver()
        commander.activate()

    def operate(self, *arguments: str, status: int = 0) -> str:
        process = self.processes.operate(*arguments)
        assert process.wait(4 * TIMEOUT_S) == status, process.output()
        return process.last_line()

    def wait_for(self, state: int, text: str = "") -> GaitState:
        return self.commander.wait_for_state(state, f"state {state} {text}", text)

    def run(self, *arguments: str) -> Process:
        """Start a run and wait until it moves."""
        process = self.processes.operate("run", *(arguments or LONG), "--json")
        self.wait_for(GaitState.RUNNING)
        return process


@pytest.fixture
def lab(robot, processes: Processes, commander: Commander) -> Iterator[Lab]:
    yield Lab(robot, processes, commander)
    robot.end_driver(commander)


def test_state_and_commands_before_the_first_run(lab: Lab):
    # `state` listens for a second. On a busy machine no camera sample may arrive in it.
    states = iter(lambda: json.loads(lab.operate("state", "--json")), None)
    state = next(each for each in states if each["rear_position"] is not None)
    assert (state["lifecycle"], state["state"], state["homed"]) == ("active", "IDLE", True)
    assert state["power"] > 0.0
    assert abs(state["rear_position"]) < 0.01
    assert "homing needs the torque off" in lab.operate("home", status=1)
    assert "outside" in lab.operate("run", *LONG[2:], "--stroke", "0.5", status=2)
    lab.operate("deactivate")
    lab.operate("home")
    assert "shaft" in lab.operate("fault", "stalled", "--target", "1", "--delay", "100")
    assert "no fault" in lab.operate("fault", "nonsense", status=1)
    assert "the torque is off" in lab.operate("run", *LONG, status=1)


@pytest.mark.parametrize(
    "end", [signal.SIGSTOP, pytest.param(signal.SIGKILL, marks=pytest.mark.night)]
)
def test_a_robot_whose_operator_is_killed_or_cut_off_comes_to_rest(lab: Lab, end: signal.Signals):
    run = lab.run()
    run.signal(end)
    lab.wait_for(GaitState.STOPPING, "heartbeat arrived for 3 s")
    lab.wait_for(GaitState.IDLE)
    run.kill()


def test_ctrl_c_stops_at_the_next_rest_and_another_one_at_once(lab: Lab):
    run = lab.run()
    run.interrupt()
    assert run.wait(2 * TIMEOUT_S) == 1
    result = json.loads(next(line for line in run.output().splitlines() if line[:1] == "{"))
    assert "cancelled, at rest after" in result["message"]
    lab.wait_for(GaitState.IDLE)
    run = lab.run("--stroke", "0.05", "--frequency", "0.02", "--cycles", "9")
    run.interrupt()
    run.wait_for_line("Ctrl-C again holds immediately", TIMEOUT_S)
    run.interrupt()
    assert run.wait(TIMEOUT_S) == 1
    assert "the service stop was called" in lab.wait_for(GaitState.IDLE).message


def test_a_run_ends_when_it_has_gained_its_grooves_or_makes_no_progress(lab: Lab):
    gait = ("--stroke", "0.0754", "--frequency", "0.3")
    lab.operate("run", *gait, "--cycles", "1")  # meanwhile, the driver finds the tracker
    result = json.loads(lab.operate("run", *gait, "--grooves", "3", "--json"))
    assert result["success"]
    assert result["cycles_completed"] == 2
    assert 3 <= result["grooves"] < 5
    result = json.loads(lab.operate("run", *gait, "--distance", "0.03", "--json"))
    assert 0.03 <= result["distance"] < 0.08
    without_progress = lab.operate(
        *("run", "--stroke", "0.02", "--frequency", "0.4", "--grooves", "3"), status=1
    )
    assert "gains no groove with this gait" in without_progress


@pytest.mark.night
def test_a_gait_is_tuned_on_the_robot_within_the_limits_of_its_driver(lab: Lab, tmp_path: Path):
    gait = ("--stroke", "0.0754", "--frequency", "0.3", "--record", str(tmp_path / "bags"))
    tuned = json.loads(lab.operate("tune", *gait, "--probability", "0.9", "--json"))
    assert tuned["state"] == "done"
    assert tuned["keeps_probability"]["value"] >= 0.9
    assert tuned["gait"]["stroke"] <= 0.09
    assert sorted(Path(bag) for bag in tuned["bags"]) == sorted((tmp_path / "bags").iterdir())
    recorded = sorted((tmp_path / "bags").iterdir())
    rejected = ("--stroke", "0.5", *gait[2:])
    assert "outside" in lab.operate("tune", *rejected, status=2)
    assert "outside" in lab.operate("run", *rejected, status=2)
    assert sorted((tmp_path / "bags").iterdir()) == recorded


def test_the_emergency_stop_holds_and_rejects_every_start_also_of_the_next_driver(lab: Lab):
    run = lab.run()
    button = lab.probe.node.create_publisher(Bool, "emergency_stop", 1)
    lab.probe.wait_for(button.get_subscription_count, "driver that listens")
    released = threading.Event()

    def repeat() -> None:
        """Publish the state of a pressed button twice a second."""
        button.publish(Bool(data=True))
        while not released.wait(0.5):
            button.publish(Bool(data=True))

    pressed = threading.Thread(target=repeat)
    pressed.start()
    lab.wait_for(GaitState.IDLE, "the emergency stop is on")
    assert "button" in lab.operate("emergency_stop", "off", status=1)
    released.set()
    pressed.join()
    held = lab.wait_for(GaitState.IDLE, "the emergency stop is on")
    assert held.emergency_stop
    assert run.wait(TIMEOUT_S) == 1
    goal = RunGait.Goal(gait=Gait(stroke=0.03, frequency=0.4, direction=1), cycles=1)

    def is_rejected() -> bool:
        """Return True if the stop rejects a goal, and not a message of the button that follows the goal."""
        sent = lab.probe.send_goal(RunGait, "run_gait", goal)
        return "the emergency stop is on" in lab.probe.rejection(sent)

    lab.probe.wait_for(is_rejected, "rejection")

    driver = lab.robot.driver()
    driver.kill()
    driver.wait(TIMEOUT_S)
    lab.robot.processes.forget("driver_node")
    other_name = lab.robot.directory / "ttyUSB0"
    other_name.symlink_to("servo_bus")  # the same device
    lab.robot.start_driver(port=other_name)
    assert "the emergency stop is on" in lab.operate("activate", status=1)
    assert json.loads(lab.operate("state", "--json"))["emergency_stop"]
    assert "permitted" in lab.operate("emergency_stop", "off")
    lab.operate("activate")
    assert lab.operate("run", *LONG[:4], "--cycles", "1", "--json")
    lab.operate("deactivate")


def test_a_missing_driver_is_reported(module_domain, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["operate", "state", "--namespace", "/none", "--timeout", "1"])
    assert operate.main() == 1
    assert "no driver in /none within 1 s" in capsys.readouterr().err.splitlines()[-1]
