# SPDX-License-Identifier: Apache-2.0
"""A virtual robot that serves its ports in a thread, without ROS, and a terminal without a robot."""

import os
import threading
import tty
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from worm_driver.virtual_robot.robot_server import I2C_NAME, SERIAL_NAME, RobotServer
from worm_driver.virtual_robot.virtual_robot import VirtualRobot
from worm_driver.virtual_robot.virtual_settings import RobotSettings, load_settings


class Served:
    """Robot that serves its ports in a thread."""

    def __init__(self, directory: Path, rate: float | None) -> None:
        self.directory = directory
        self.port, self.socket = str(directory / SERIAL_NAME), str(directory / I2C_NAME)
        self.robot = VirtualRobot(load_settings())
        self.server = RobotServer(self.robot, directory, lambda _: None, rate=rate, epoch_ns=10**18)
        self.server.open()
        self._thread = threading.Thread(target=self.server.run)
        self._thread.start()

    def end(self) -> None:
        """Clean up as the process does at its end."""
        if self._thread.is_alive():
            self.server.stop()
            self._thread.join()
            self.server.close()


@pytest.fixture(scope="session")
def settings() -> RobotSettings:
    """Return the installed settings."""
    return load_settings()


@pytest.fixture
def serve(tmp_path: Path) -> Iterator[Callable[[float | None], Served]]:
    """Return a function that serves a robot at a rate, in the folder ``robot``."""
    made: list[Served] = []

    def start(rate: float | None) -> Served:
        made.append(Served(tmp_path / "robot", rate))
        return made[-1]

    yield start
    for each in made:
        each.end()


@pytest.fixture
def terminal() -> Iterator[str]:
    """Open a pseudo-terminal whose other end does not respond."""
    master, slave = os.openpty()
    tty.setraw(slave)
    yield os.ttyname(slave)
    os.close(master)
    os.close(slave)
