# SPDX-License-Identifier: Apache-2.0
"""The whole node graph of system.yaml: Ctrl-C of each node in turn, while a gait runs."""

import re
from pathlib import Path

import pytest
from harness import LATCHED, NAMESPACE, SERVOS, VirtualWorm
from interfaces_page import rows_of
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy
from sensor_msgs.msg import JointState

from worm_msgs.action import RunGait
from worm_msgs.msg import Gait, GaitState
from worm_optimizer.operation.processes import executable_command
from worm_optimizer.operation.system import MODES, installed_system_file

# Topics and services of every node, or of every lifecycle node.
COMMON_SERVICES = re.compile(
    r"/(describe_parameters|get_parameter_types|get_parameters|list_parameters|set_parameters(_atomically)?|"
    r"get_type_description|get_available_(states|transitions)|get_transition_graph)$"
)
LONG_GAIT = RunGait.Goal(
    gait=Gait(stroke=0.07, frequency=0.4, direction=Gait.FORWARD, margin=0.0), cycles=60
)
BYSTANDERS = ("twin", "optimizer")
OF_OPERATORS = (
    "heartbeat",
    "emergency_stop",
)  # published by clients that start gaits; this graph has none


@pytest.fixture
def worm(processes, probe, tmp_path) -> VirtualWorm:
    """All nodes of the virtual mode, the driver activated."""
    worm = VirtualWorm(processes, probe, tmp_path)
    worm.start()
    worm.wait_until_active()
    return worm


def test_each_node_ends_on_ctrl_c_and_the_driver_stops_the_servos(worm, probe):
    states = probe.collect(GaitState, "gait_state", LATCHED)
    joints = probe.collect(JointState, "joint_states")
    assert probe.send_goal(RunGait, "run_gait", LONG_GAIT).accepted
    probe.wait_for(lambda: states and states[-1].cycle >= 1, "running gait")
    probe.wait_for(lambda: joints and abs(joints[-1].velocity[0]) > 0.5, "moving cable servo")

    for name in BYSTANDERS:
        probe.wait_for(lambda name=name: name in probe.node.get_node_names(), f"node {name}")
        assert worm.interrupt(name) == 0, name
        cycle = states[-1].cycle
        probe.wait_for(lambda cycle=cycle: states[-1].cycle > cycle, f"cycle without {name}")
        assert states[-1].state == GaitState.RUNNING

    # The recorder continues until the robot rests, see --to-rest.
    worm.processes.processes["recorder"].interrupt()
    # Within 1.5 s, a second signal belongs to the same Ctrl-C. A cycle is longer.
    cycle = states[-1].cycle
    probe.wait_for(lambda: states[-1].cycle > cycle + 1, "cycle with a recorder asked to end")
    assert worm.processes.processes["recorder"].exit_code is None
    assert worm.interrupt("recorder") == 0

    assert worm.interrupt("driver") == 0
    assert worm.torques() == dict.fromkeys(SERVOS, 0)
    assert worm.interrupt("virtual_robot") == 0


def test_topics_services_and_actions_are_those_of_the_documentation(worm, probe):
    """Names, types and quality of service as the running nodes announce them."""
    node = probe.node

    def own(names_and_types):
        prefix = f"{NAMESPACE}/"
        found = {name.removeprefix(prefix): kind for name, [kind] in names_and_types}
        return {name: kind for name, kind in found.items() if not name.startswith("/")}

    def published():
        topics = own(node.get_topic_names_and_types())
        with_publisher = {
            n: k for n, k in topics.items() if node.count_publishers(n) and "/_" not in n
        }
        return {n: k for n, k in with_publisher.items() if not n.endswith("/transition_event")}

    absent = ("/", "camera/", *OF_OPERATORS)  # names outside of the namespace, and no camera
    topics = {name: row for name, row in rows_of("Topics").items() if not name.startswith(absent)}
    probe.wait_for(lambda: set(published()) >= set(topics), "all topics")
    assert {n: k.replace("/msg", "") for n, k in published().items()} == {
        name: row[0] for name, row in topics.items()
    }
    for name, row in topics.items():
        latched = "transient local" in row[3]
        for info in node.get_publishers_info_by_topic(name):
            assert info.qos_profile.reliability is ReliabilityPolicy.RELIABLE
            durability = info.qos_profile.durability
            assert (durability is DurabilityPolicy.TRANSIENT_LOCAL) == latched, name

    services = {n: r for n, r in rows_of("Services").items() if not n.startswith(("~", "driver/"))}
    actions = rows_of("Actions")
    wanted = set(services) | {f"{name}/_action/send_goal" for name in actions}
    probe.wait_for(lambda: set(own(node.get_service_names_and_types())) >= wanted, "all services")
    every = own(node.get_service_names_and_types())
    goals = {n.removesuffix("/_action/send_goal"): k for n, k in every.items() if "send_goal" in n}
    assert {n: k.replace("/action", "").removesuffix("_SendGoal") for n, k in goals.items()} == {
        name: row[0] for name, row in actions.items()
    }
    plain = {n: k for n, k in every.items() if "/_action" not in n and "driver/change" not in n}
    plain = {n: k for n, k in plain.items() if not COMMON_SERVICES.search(f"/{n}")}
    plain = {n: k for n, k in plain.items() if n != "driver/get_state"}
    assert {n: k.replace("/srv", "") for n, k in plain.items()} == {
        name: row[0] for name, row in services.items()
    }


@pytest.mark.parametrize("mode", MODES)
def test_every_executable_of_every_mode_is_installed(mode):
    for node in installed_system_file().system(mode, bag="any").nodes:
        assert Path(executable_command(node.package, node.executable)[-1]).is_file()
