# SPDX-License-Identifier: Apache-2.0
"""Command ``check``: its table, its JSON object and its exit status, on the ports of a virtual robot."""

import json
import math

from worm_driver.commands.check import main
from worm_driver.control.bench_check import State
from worm_driver.virtual_robot.wire.faults import make_fault


def test_a_healthy_robot_then_a_faulty_one(serve, monkeypatch, capsys):
    monkeypatch.setenv("ROS_DOMAIN_ID", "230")
    served = serve(math.inf)
    ports = ["--port", served.port, "--i2c-bus", served.socket]
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
    served.server.inject(make_fault("overload", target=11))
    assert main(ports) == 1
    lines = capsys.readouterr().out.splitlines()
    faulty = [number for number, line in enumerate(lines) if State.FAILED.value in line]
    assert [lines[number].split()[0] for number in faulty] == ["hardware"]
    assert "reboot" in lines[faulty[0] + 1]
