# SPDX-License-Identifier: Apache-2.0
"""The command operate on a driver and a virtual robot; its death, its loss of contact, and the emergency stop."""

import json
import signal
import sys
import threading
from pathlib import Path

import pytest
from harness import LATCHED, NAMESPACE, TIMEOUT_S, Probe, Processes
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rclpy.qos import QoSProfile
from std_msgs.msg import Bool

from worm_msgs.action import RunGait
from worm_msgs.msg import Gait, GaitState
from worm_optimizer.commands import operate
from worm_optimizer.operation.processes import Process

#: of a latched topic, whose queue also keeps a state that is shorter than a pause of this process
EVERY_STATE = QoSProfile(depth=1000, reliability=LATCHED.reliability, durability=LATCHED.durability)
LONG = ("--stroke", "0.03", "--frequency", "0.4", "--cycles", "200")


@pytest.fixture(autouse=True)
def _state_of_its_own(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("WORM_STATE_DIRECTORY", str(tmp_path / "state"))


class Lab:
    """Virtual robot, its driver, and an operator who uses commands."""

    def __init__(self, processes: Processes, probe: Probe, folder: Path) -> None:
        self.processes, self.probe, self.folder = processes, probe, folder
        robot = processes.start_node("worm_driver", "virtual_robot", "--directory", str(folder))
        robot.wait_for_line("^ready: ", TIMEOUT_S)
        self.start_driver("driver")
        self.states = probe.collect(GaitState, "gait_state", EVERY_STATE)
        self._commands = 0

    def start_driver(self, name: str, port: str = "servo_bus") -> Process:
        ros = ["--ros-args", "-r", f"__ns:={NAMESPACE}", "-p", "home_at_start:=true"]
        ros += ["-p", f"port:={self.folder / port}"]
        ros += ["-p", f"i2c_bus:={self.folder / 'i2c.sock'}"]
        return self.processes.start_executable("worm_driver", "driver_node", *ros, name=name)

    def begin(self, *arguments: str) -> Process:
        self._commands += 1
        arguments = (*arguments, "--timeout", f"{TIMEOUT_S:g}")
        return self.processes.start_executable(
            "worm_optimizer", "operate", *arguments, name=f"operate_{self._commands}"
        )

    def operate(self, *arguments: str, status: int = 0) -> str:
        process = self.begin(*arguments)
        assert process.wait(4 * TIMEOUT_S) == status, process.output()
        return process.last_line()

    def wait_for(self, state: int, text: str = "") -> GaitState:
        def there() -> GaitState | None:
            last = self.states[-1] if self.states else None
            return last if last and last.state == state and text in last.message else None

        found: GaitState = self.probe.wait_for(there, f"state {state} {text}", 2 * TIMEOUT_S)
        return found

    def run(self, *arguments: str) -> Process:
        """Start a run and wait until it moves."""
        process = self.begin("run", *(arguments or LONG), "--json")
        self.wait_for(GaitState.RUNNING)
        return process


@pytest.fixture
def lab(processes: Processes, probe: Probe, tmp_path: Path) -> Lab:
    lab = Lab(processes, probe, tmp_path / "robot")
    lab.operate("activate")
    return lab


@pytest.mark.parametrize("end", [signal.SIGKILL, signal.SIGSTOP])
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

    lab.processes.processes["driver"].kill()
    (lab.folder / "ttyUSB0").symlink_to("servo_bus")
    lab.start_driver("second_driver", "ttyUSB0")  # the same device under another name
    assert "the emergency stop is on" in lab.operate("activate", status=1)
    assert json.loads(lab.operate("state", "--json"))["emergency_stop"]
    assert "permitted" in lab.operate("emergency_stop", "off")
    lab.operate("activate")
    assert lab.operate("run", *LONG[:4], "--cycles", "1", "--json")
    request = ChangeState.Request(transition=Transition(id=Transition.TRANSITION_DEACTIVATE))
    assert lab.probe.call(ChangeState, "driver/change_state", request).success


def test_state_and_commands_without_a_run(lab: Lab):
    # `state` listens for a second. On a busy machine no camera sample may arrive in it.
    states = iter(lambda: json.loads(lab.operate("state", "--json")), None)
    state = next(each for each in states if each["rear_position"] is not None)
    assert (state["lifecycle"], state["state"], state["homed"]) == ("active", "IDLE", True)
    assert state["power"] > 0.0
    assert abs(state["rear_position"]) < 0.01
    assert "homing needs the torque off" in lab.operate("home", status=1)
    too_long = lab.begin("run", *LONG[2:], "--stroke", "0.5")
    assert too_long.wait(4 * TIMEOUT_S) == 2
    assert too_long.output().count("outside") == 1
    lab.operate("deactivate")
    lab.operate("home")
    assert "shaft" in lab.operate("fault", "stalled", "--target", "1", "--delay", "100")
    assert "no fault" in lab.operate("fault", "nonsense", status=1)
    assert "the torque is off" in lab.operate("run", *LONG, status=1)


def test_a_missing_driver_is_reported(processes: Processes):
    command = processes.start_executable("worm_optimizer", "operate", "state", "--timeout", "1")
    assert command.wait(TIMEOUT_S) == 1
    assert "no driver in /worm within 1 s" in command.last_line()


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (("run", "--stroke", "0.05"), "give --stroke and --frequency"),
        (("run", "--stroke", "-1", "--frequency", "0.2"), "stroke"),
        (("run", *LONG[:4], "--objective", "cruise"), "omit --objective"),
        (("run", "--pretension", "0.01"), "--pretension needs a gait in numbers"),
        (("run", "--profile", "trapezoid", "--objective", "cruise"), "--profile needs"),
        (("run", *LONG[:4], "--contraction-share", "1"), "contraction_share"),
        (("run", "--cycles", "-3"), "cycles: -3"),
        (("tune", "--stroke", "0.05"), "give --stroke and --frequency"),
        (("tune", "--probability", "1"), "--probability 1"),
        (("tune", "--grooves", "0"), "--grooves 0"),
        (("dance",), "invalid choice"),
    ],
)
def test_bad_input_is_one_line(
    arguments: tuple[str, ...],
    complaint: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture,
):
    monkeypatch.setattr(sys, "argv", ["operate", *arguments])
    try:
        status = operate.main()
    except SystemExit as end:  # of argparse
        status = end.code
    assert status == 2
    assert complaint in capsys.readouterr().err.splitlines()[-1]
