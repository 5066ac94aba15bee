# SPDX-License-Identifier: Apache-2.0
"""A virtual robot that serves its ports in a thread, without ROS."""

import threading
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from worm_driver.virtual_robot.robot_server import I2C_NAME, SERIAL_NAME, RobotServer
from worm_driver.virtual_robot.virtual_robot import VirtualRobot
from worm_driver.virtual_robot.virtual_settings import RobotSettings, load_settings


@dataclass
class Served:
    """Robot with its ports."""

    robot: VirtualRobot
    directory: Path
    server: RobotServer
    thread: threading.Thread

    def end(self) -> None:
        """Clean up as the process does at its end."""
        if self.thread.is_alive():
            self.server.stop()
            self.thread.join()
            self.server.close()

    @property
    def port(self) -> str:
        return str(self.directory / SERIAL_NAME)

    @property
    def socket(self) -> str:
        return str(self.directory / I2C_NAME)


@pytest.fixture(scope="session")
def settings() -> RobotSettings:
    """Return the installed settings."""
    return load_settings()


@pytest.fixture
def served(settings: RobotSettings, tmp_path: Path) -> Iterator[Served]:
    """Start a robot behind a pseudo-terminal and a socket."""
    robot = VirtualRobot(settings)
    server = RobotServer(robot, tmp_path, lambda _: None)
    server.open()
    thread = threading.Thread(target=server.run)
    thread.start()
    served = Served(robot, tmp_path, server, thread)
    yield served
    served.end()
