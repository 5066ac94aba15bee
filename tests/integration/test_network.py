# SPDX-License-Identifier: Apache-2.0
"""Two hosts on a cable, as network namespaces:

which processes of a robot on the first host the second one discovers.
"""

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from harness import TIMEOUT_S

from worm_optimizer.operation.processes import Process, executable_command
from worm_optimizer.operation.system import installed_system_file

#: processes that the neighbour looks for, and s within which it finds them on an open network
LOOKING_S = 12.0

NEIGHBOUR = """
import sys, time, rclpy
from rclpy.executors import SingleThreadedExecutor
rclpy.init()
node = rclpy.create_node("neighbour")
executor = SingleThreadedExecutor()
executor.add_node(node)
end = time.monotonic() + float(sys.argv[1])
found = set()
while time.monotonic() < end and not found:
    executor.spin_once(timeout_sec=0.1)
    found = {name for name in node.get_node_names() if name != "neighbour"}
print("found:", *sorted(found))
"""


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


def look(host: Host, peer: Host, seconds: float) -> str:
    """Return the nodes that a neighbour discovers with the robot's computer as a peer and the widest range of ROS."""
    widened = {
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET",
        "ROS_STATIC_PEERS": f"{peer.address};{host.address}",
    }
    closed = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE", "WORM_NETWORK")
    environment = {k: v for k, v in os.environ.items() if k not in closed} | widened
    given = subprocess.run(
        host.command(sys.executable, "-c", NEIGHBOUR, str(seconds)),
        env=environment,
        capture_output=True,
        text=True,
        timeout=seconds + TIMEOUT_S,
    )
    assert given.returncode == 0, given.stderr
    return given.stdout


def start_driver(processes, host: Host, *environment: str, name: str = "driver") -> Process:
    command = executable_command("worm_driver", "driver_node")
    return processes.start(name, host.command("env", *environment, *command))


@pytest.mark.night
@pytest.mark.parametrize("opens", [False, True])
def test_a_neighbour_with_static_peers_finds_only_a_driver_that_may_use_the_network(
    processes, probe, hosts, opens: bool
):
    robot, neighbour = hosts
    driver = start_driver(processes, robot, f"WORM_NETWORK={'1' if opens else ''}")
    probe.wait_for(lambda: robot.udp_ports(driver), "driver with its ports")
    found = look(neighbour, robot, LOOKING_S)
    assert "driver" in found if opens else found == "found:\n"


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
