# SPDX-License-Identifier: Apache-2.0
"""The directory of a virtual robot: which process may use it, and which files remain. The server's simulated time."""

import math
import socket

import pytest

from worm_driver.simulated_clock import I2C, SERIAL, Wait
from worm_driver.virtual_robot.robot_server import DirectoryError, RobotServer
from worm_driver.virtual_robot.virtual_robot import VirtualRobot
from worm_driver.virtual_robot.wire.clock_server import ClockClient


@pytest.fixture
def make(settings):
    made = []

    def build(directory):
        server = RobotServer(VirtualRobot(settings), directory, lambda samples: None)
        made.append(server)
        return server

    yield build
    for server in made:
        server.close()


def test_leftovers_of_a_killed_robot_are_cleared(make, tmp_path):
    first = make(tmp_path)
    first.open()
    (tmp_path / "kept").symlink_to(tmp_path / "servo_bus")
    (tmp_path / "moved").write_bytes(b"")
    first.close()
    (tmp_path / "servo_bus").symlink_to("/dev/pts/9999")
    make(tmp_path).open()
    assert (tmp_path / "servo_bus").exists()


def test_a_file_in_the_way_is_left_alone(make, tmp_path):
    (tmp_path / "servo_bus").write_text("mine")
    with pytest.raises(DirectoryError, match="is in the way"):
        make(tmp_path).open()
    assert (tmp_path / "servo_bus").read_text() == "mine"


def test_a_path_too_long_for_a_socket(make, tmp_path):
    with pytest.raises(DirectoryError, match="shorter --directory"):
        make(tmp_path / ("x" * 120)).open()


def test_after_a_long_wait_time_still_does_not_pass_while_bytes_are_in_transit(make, tmp_path):
    """Another client may compute for seconds, during which a serial client waits without any bytes in transit."""
    server = make(tmp_path)
    server.open()
    machine = 100.0
    server._clock = lambda: machine
    server.time.begin(machine)
    now = server.time.now
    serial = ClockClient(SERIAL, Wait(1, math.inf, False, written=0, read=0), since=machine)
    other = ClockClient(I2C)
    ends = socket.socketpair()
    server._clients.update(zip(ends, (serial, other), strict=True))
    machine += 5.0
    assert server._advance_time() == now
    # The serial client writes 14 bytes, which the server has not received yet.
    serial.wait, serial.since = Wait(2, math.inf, True, written=14, read=0), machine
    other.wait = Wait(1, math.inf, False, 0, 0)
    machine += 0.1
    assert server._advance_time() == now
    server._bytes_received += 14
    assert server._advance_time() > now
    for end in ends:
        end.close()


def test_a_robot_is_in_use_while_its_clock_has_a_client_although_the_bus_is_silent(make, tmp_path):
    server = make(tmp_path)
    assert server.is_unused(0.5)
    with socket.socket() as connection:
        server._clients[connection] = ClockClient(SERIAL)
        assert not server.is_unused(0.5)
        server._clients.clear()
    assert server.is_unused(0.5)
