# SPDX-License-Identifier: Apache-2.0
"""Fixtures of the tests with real processes over real DDS."""

import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from commander import SERVOS, Commander, parameters, servo_bus
from harness import TIMEOUT_S, Probe, Processes

from worm_driver.servos.registers import COMMON
from worm_optimizer.operation.processes import Process


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item):
    """Show the output of the started processes with a failure."""
    report = yield
    if report.failed:
        page = getattr(item, "funcargs", {}).get("page")
        if page is not None and not page.is_closed():
            report.sections.append(("text of the page", page.locator("body").inner_text()))
        given = getattr(item, "funcargs", {}).values()
        shared = [getattr(value, "processes", None) for value in given]  # by a lab, for example
        groups = {group for group in (*given, *shared) if isinstance(group, Processes)}
        report.sections += [
            (f"output of {process.name}", process.output())
            for group in groups
            for process in group.processes.values()
        ]
    return report


@pytest.fixture
def processes(ros_domain: int, tmp_path: Path) -> Iterator[Processes]:
    """Start installed executables, and end them after the test."""
    folder = tmp_path / "logs"
    folder.mkdir()
    with Processes(folder) as group:
        yield group


REST_TICKS = 26  # 1 mm of cable


class Robot:
    """Virtual robot that the tests of a module share, and its driver of the moment."""

    def __init__(self, processes: Processes, directory: Path) -> None:
        self.processes, self.directory = processes, directory
        robot = processes.start_node("worm_driver", "virtual_robot", "--directory", str(directory))
        robot.wait_for_line("^ready: ", TIMEOUT_S)

    def start_driver(self, **changes: object) -> Process:
        (self.processes.log_folder / "driver_node.log").unlink(missing_ok=True)
        given = parameters(self.directory, **changes)
        return self.processes.start_node("worm_driver", "driver_node", **given)

    def driver(self) -> Process:
        return self.processes.processes.get("driver_node") or self.start_driver()

    def end_driver(self, commander: Commander) -> None:
        """End the driver, bring the cable to rest, release the torque, and reset faults and the emergency stop."""
        for name in [name for name in self.processes.processes if name != "virtual_robot"]:
            self.processes.processes[name].kill()
            self.processes.forget(name)
        commander.inject(name="clear")
        with servo_bus(self.directory) as bus:
            for servo in SERVOS:
                bus.write(servo, COMMON["bus_watchdog"], 0)
            bus.write(1, COMMON["torque_enable"], 1)
            bus.write(1, COMMON["goal_position"], 0)
            position = COMMON["present_position"]
            commander.probe.wait_for(lambda: abs(bus.read(1, position)) < REST_TICKS, "rest")
            for servo in SERVOS:
                bus.write(servo, COMMON["torque_enable"], 0)
        for file in Path(os.environ["WORM_STATE_DIRECTORY"]).iterdir():
            file.unlink()


@pytest.fixture(scope="module")
def robot(module_domain: int, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Robot]:
    """Start the shared robot. A module that uses it lets its ``ros_domain`` be ``module_domain``."""
    folder = tmp_path_factory.mktemp("logs")
    with Processes(folder) as group:
        yield Robot(group, folder / "robot")


@pytest.fixture
def directory(robot: Robot) -> Path:
    return robot.directory


@pytest.fixture
def commander(probe: Probe) -> Commander:
    return Commander(probe)


@pytest.fixture
def probe(ros_domain: int) -> Iterator[Probe]:
    """Create a node of the test with subscriptions, and service and action calls with deadlines."""
    probe = Probe(ros_domain)
    yield probe
    probe.close()
