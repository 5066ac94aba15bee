# SPDX-License-Identifier: Apache-2.0
"""Two hosts on a cable, as network namespaces: what a robot's processes are bound to, and drivers on both hosts."""

import os
import re
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from harness import TIMEOUT_S

from worm_optimizer.operation.processes import Process, executable_command
from worm_optimizer.operation.system import installed_system_file


def _ip(*arguments: str) -> None:
    subprocess.run(["ip", *arguments], check=True, capture_output=True, text=True)


class Host:
    """Network namespace with a cable to the other one. Its programs have their own /dev/shm, as hosts do."""

    def __init__(self, name: str, address: str) -> None:
        self.name, self.address = name, address

    def command(self, *command_line: str) -> list[str]:
        private = 'mount -t tmpfs none /dev/shm && exec "$@"'
        return ["ip", "netns", "exec", self.name, "sh", "-c", private, "sh", *command_line]

    def tc(self, action: str, *command_line: str) -> str:
        """Add or delete a queueing discipline of the cable, and return the errors."""
        command = ["ip", "netns", "exec", self.name, "tc", "qdisc", action, "dev", "cable", "root"]
        return subprocess.run([*command, *command_line], capture_output=True, text=True).stderr

    def udp_ports(self, process: Process) -> list[str]:
        """Return the addresses to which a program of this host is bound."""
        command = ["ip", "netns", "exec", self.name, "ss", "-H", "-l", "-u", "-n", "-p"]
        given = subprocess.run(command, check=True, capture_output=True, text=True).stdout
        lines = [line for line in given.splitlines() if f"pid={process.pid}," in line]
        return [line.split()[3] for line in lines]


@pytest.fixture
def hosts() -> Iterator[tuple[Host, Host]]:
    """Create the robot's computer and a neighbour on one network."""
    mark = f"worm{os.getpid()}"
    robot, neighbour = Host(f"{mark}a", "10.77.0.1"), Host(f"{mark}b", "10.77.0.2")
    made = []
    try:
        try:
            for host in (robot, neighbour):
                _ip("netns", "add", host.name)
                made.append(host)
            _ip("-n", robot.name, "link", "add", "cable", "type", "veth", "peer", "name", "cable",
                "netns", neighbour.name)  # fmt: skip
            for host in made:
                _ip("-n", host.name, "address", "add", f"{host.address}/24", "dev", "cable")
                for device in ("lo", "cable"):
                    _ip("-n", host.name, "link", "set", device, "up")
                _ip("-n", host.name, "route", "add", "224.0.0.0/4", "dev", "cable")
            subprocess.run(robot.command("true"), check=True, capture_output=True)
        except (OSError, subprocess.CalledProcessError) as error:
            reason = getattr(error, "stderr", "") or error
            pytest.skip(
                f"network namespaces need ip (iproute2) and the right to make them: {reason}"
            )
        yield robot, neighbour
    finally:
        for host in made:
            _ip("netns", "delete", host.name)


def start_driver(processes, host: Host, *environment: str, name: str = "driver") -> Process:
    command = executable_command("worm_driver", "driver_node")
    return processes.start(name, host.command("env", *environment, *command))


def test_a_second_driver_on_the_network_ends_before_it_serves_anything(processes, hosts):
    first, second = hosts
    start_driver(processes, first, "WORM_NETWORK=1").wait_for_line("waiting for conf", TIMEOUT_S)
    other = start_driver(processes, second, "WORM_NETWORK=1", name="second")
    assert other.wait(2 * TIMEOUT_S) == 2
    other.wait_for_line("/ has 2 drivers on the network: nothing starts", TIMEOUT_S)
    assert "waiting for conf" not in other.output()


@pytest.mark.night
def test_two_drivers_that_discover_each_other_late_do_not_start(processes, hosts):
    """The cable between their computers transmits nothing before both are ready."""
    cut = [host.tc("add", "pfifo", "limit", "0") for host in hosts]
    if any(cut):
        pytest.skip(f"a cable that drops all packets needs tc (iproute2): {cut}")
    drivers = [start_driver(processes, host, "WORM_NETWORK=1", name=host.name) for host in hosts]
    for driver in drivers:
        driver.wait_for_line("waiting for configure", TIMEOUT_S)
    assert not any(host.tc("delete") for host in hosts)
    for driver in drivers:
        driver.wait_for_line("/ has 2 drivers on the network: nothing starts", 2 * TIMEOUT_S)


def test_every_process_is_bound_to_the_loopback_interface_alone(
    processes, probe, hosts, tmp_path: Path, monkeypatch
):
    robot, _ = hosts
    monkeypatch.chdir(tmp_path)
    for node in installed_system_file().system("virtual", bag="bag", directory="robot").nodes:
        command = executable_command(node.package, node.executable)
        process = processes.start(node.name, robot.command(*command, *node.arguments))
        ports = probe.wait_for(lambda p=process: robot.udp_ports(p), f"{node.name} with its ports")
        assert [port for port in ports if not re.match(r"127\.0\.0\.1:\d+$", port)] == []
