# SPDX-License-Identifier: Apache-2.0
"""Timing of the 100 Hz loop of the driver on the virtual robot, both as processes, while a gait runs."""

from __future__ import annotations

import contextlib
import itertools
import math
import os
import statistics
import subprocess
import tempfile
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import rclpy
from action_msgs.msg import GoalStatus
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.action import ActionClient
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from sensor_msgs.msg import JointState

from benchmarks.report import Row
from worm_msgs.action import RunGait
from worm_msgs.msg import Gait, Power
from worm_optimizer.operation.processes import ProcessGroup, executable_command

TITLE = "period of the driver's loop, its load, and the age of a sample on arrival"

DOMAIN = 38
PERIOD = 0.01
TIMEOUT = 60.0
ROBOT_PRIORITY = 60


# For a machine that does not give the virtual robot its processor in time, which is no fault of a servo.
WIDENED = {
    "bus_watchdog_s": 1.0,
    "limits.max_silence_s": 0.8,
    "limits.max_following_error_m": 0.06,
}


class GaitFailedError(RuntimeError):
    """A gait did not reach its end. The message contains the reason."""


@contextlib.contextmanager
def _robot_and_driver(folder: Path, changes: Mapping[str, float]) -> Iterator[int]:
    """Start both processes, the driver with some changed parameters, and yield the process id of the driver."""
    environment = {**os.environ, "ROS_DOMAIN_ID": str(DOMAIN)}
    with ProcessGroup(folder, environment) as group:
        robot = executable_command("worm_driver", "virtual_robot")
        doors = folder / "robot"
        command = [*_as_hardware(), *robot, "--real-time", "--directory", str(doors)]
        group.start("robot", command).wait_for_line("^ready", TIMEOUT)
        parameters = {
            "port": doors / "servo_bus",
            "i2c_bus": doors / "i2c.sock",
            "home_at_start": "true",
            "autostart": "true",
            **changes,
        }
        command = [*executable_command("worm_driver", "driver_node"), "--ros-args"]
        for key, value in parameters.items():
            command += ["-p", f"{key}:={value}"]
        yield group.start("driver", command).pid


def _as_hardware() -> list[str]:
    """Return a prefix of the robot's command line.

    If permitted, it gives the robot a priority that other load does not affect, like that of real servos.
    """
    probe = subprocess.run(
        ["chrt", "-f", str(ROBOT_PRIORITY), "true"], capture_output=True, check=False
    )
    return [] if probe.returncode else ["chrt", "-f", str(ROBOT_PRIORITY)]


class Watcher:
    """Node that runs a gait and stores the stamps of its samples and the diagnostics of the driver."""

    def __init__(self) -> None:
        self.context = rclpy.Context()
        self.context.init(domain_id=DOMAIN)
        self.node = Node("watcher", context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.stamps: list[float] = []
        self.ages: list[float] = []
        self.power = 0
        self.timing: dict[str, str] = {}
        self.node.create_subscription(JointState, "joint_states", self._on_joints, 1000)
        self.node.create_subscription(Power, "power", self._on_power, 1000)
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)

    def _on_joints(self, message: JointState) -> None:
        stamp = message.header.stamp.sec + message.header.stamp.nanosec * 1e-9
        self.ages.append(time.time() - stamp)
        self.stamps.append(stamp)

    def _on_power(self, _: Power) -> None:
        self.power += 1

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name == "driver: timing":
                self.timing = {value.key: value.value for value in status.values}

    def wait_for(self, condition: Any) -> None:
        """Spin until a future is done or a callable returns True."""
        end = time.monotonic() + TIMEOUT
        done = condition.done if hasattr(condition, "done") else condition
        while not done():
            if time.monotonic() > end:
                raise TimeoutError("the driver did not do what was asked of it")
            self.executor.spin_once(timeout_sec=0.1)

    def run_gait(self, gait: Gait, cycles: int) -> None:
        """Run a gait from the goal to the result."""
        client = ActionClient(self.node, RunGait, "run_gait")
        self.wait_for(client.server_is_ready)
        while True:
            sent = client.send_goal_async(RunGait.Goal(gait=gait, cycles=cycles))
            self.wait_for(sent)
            result = sent.result().get_result_async()
            self.wait_for(result)
            if result.result().status == GoalStatus.STATUS_SUCCEEDED:
                return
            if "activate" not in result.result().result.message:
                raise GaitFailedError(result.result().result.message)

    def close(self) -> None:
        """Destroy the node."""
        self.executor.shutdown()
        self.node.destroy_node()
        self.context.try_shutdown()


def _processor_time(pid: int) -> float:
    """Return the processor time (s) of a process and its threads so far."""
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _percentile(values: list[float], fraction: float) -> float:
    return sorted(values)[min(len(values) - 1, math.ceil(fraction * len(values)) - 1)]


def run() -> list[Row]:
    """Run five cycles of 3 s with the default limits and, if these report a fault, again with wider ones."""
    try:
        return [*_measure({}), Row("safety limits", "as shipped", "as shipped", "driver.yaml")]
    except GaitFailedError as error:
        widened = ", ".join(f"{name} {value:g}" for name, value in WIDENED.items())
        return [
            *_measure(WIDENED),
            Row("safety limits", widened, "as shipped", f"with those as shipped: {error}"),
        ]


def _measure(changes: Mapping[str, float]) -> list[Row]:
    """Return the rows of one run. Raises GaitFailedError."""
    with tempfile.TemporaryDirectory() as name, _robot_and_driver(Path(name), changes) as pid:
        watcher = Watcher()
        try:
            watcher.wait_for(lambda: len(watcher.stamps) > 100)
            watcher.stamps.clear()
            watcher.ages.clear()
            before, start = _processor_time(pid), time.monotonic()
            watcher.run_gait(Gait(stroke=0.07, frequency=1 / 3, direction=Gait.FORWARD), 5)
            load = (_processor_time(pid) - before) / (time.monotonic() - start)
            stamps, ages = list(watcher.stamps), list(watcher.ages)
            watcher.wait_for(lambda: bool(watcher.timing))
        finally:
            watcher.close()
    errors = [abs(b - a - PERIOD) for a, b in itertools.pairwise(stamps)]
    own, wake, cycle = (
        float(watcher.timing[f"p99_{name}_s"]) for name in ("period_error", "wake", "cycle")
    )
    lost = round((stamps[-1] - stamps[0]) / PERIOD) + 1 - len(stamps)
    how = f"{len(stamps)} cycles of a running gait, 3 servos, INA219"
    return [
        Row("period error, p99, by the driver", f"{own * 1e3:.2f} ms", "< 2 ms", "diagnostics"),
        Row(
            "woken late, p99",
            f"{wake * 1e3:.2f} ms",
            "< 2 ms",
            watcher.timing["real_time_priority"],
        ),
        Row("a cycle's length, p99", f"{cycle * 1e3:.2f} ms", "< 10 ms", "answers and interpreter"),
        Row(
            "robot's priority", " ".join(_as_hardware()) or "none granted", "", "stands for servos"
        ),
        Row(
            "period error, p99, by the stamps", f"{_percentile(errors, 0.99) * 1e3:.2f} ms", "", how
        ),
        Row("period error, median", f"{statistics.median(errors) * 1e3:.3f} ms", "", how),
        Row("deadlines without a sample", f"{lost}", "0", "gaps of the stamps"),
        Row(
            "age on arrival, median", f"{statistics.median(ages) * 1e3:.1f} ms", "", "joint_states"
        ),
        Row("age on arrival, p99", f"{_percentile(ages, 0.99) * 1e3:.1f} ms", "", "joint_states"),
        Row("load of the driver", f"{load * 100:.0f} % of a core", "", "processor time"),
    ]
