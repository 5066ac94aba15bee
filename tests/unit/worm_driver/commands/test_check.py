# SPDX-License-Identifier: Apache-2.0
"""Command ``check``: its table, its JSON object and its exit status, on the ports of a virtual robot."""

import json
import threading
from collections.abc import Iterator

import pytest

from worm_driver.commands.check import main
from worm_driver.control.bench_check import State
from worm_driver.virtual_robot.robot_server import I2C_NAME, SERIAL_NAME, RobotServer
from worm_driver.virtual_robot.virtual_robot import VirtualRobot
from worm_driver.virtual_robot.virtual_settings import load_settings
from worm_driver.virtual_robot.wire.faults import make_fault


@pytest.fixture
def robot(tmp_path, monkeypatch) -> Iterator[RobotServer]:
    monkeypatch.setenv("ROS_DOMAIN_ID", "230")
    server = RobotServer(VirtualRobot(load_settings()), tmp_path, lambda _: None, rate=float("inf"))
    server.open()
    thread = threading.Thread(target=server.run)
    thread.start()
    yield server
    server.stop()
    thread.join()
    server.close()


def test_a_healthy_robot_then_a_faulty_one(robot, tmp_path, capsys):
    ports = ["--port", str(tmp_path / SERIAL_NAME), "--i2c-bus", str(tmp_path / I2C_NAME)]
    assert main([*ports, "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["ok"] is True
    assert {row["state"] for row in result["checks"]} == {"ok", "skipped"}
    for row in result["checks"]:
        assert {key: type(value) for key, value in row.items()} == {
            "name": str,
            "ok": bool,
            "state": str,
            "found": str,
            "remedy": str,
        }
    robot.inject(make_fault("overload", target=11))
    assert main(ports) == 1
    lines = capsys.readouterr().out.splitlines()
    faulty = [number for number, line in enumerate(lines) if State.FAILED.value in line]
    assert [lines[number].split()[0] for number in faulty] == ["hardware"]
    assert "reboot" in lines[faulty[0] + 1]
