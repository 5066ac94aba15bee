# SPDX-License-Identifier: Apache-2.0
"""The whole node graph of system.yaml: its interfaces, the SROS 2 policies, and Ctrl-C of each node in turn.

A policy is enough for its node, and no more (for people: enough).
"""

import re
from collections.abc import Callable, Iterator
from contextlib import closing
from importlib.util import find_spec
from pathlib import Path
from xml.etree import ElementTree

import pytest
import yaml
from camera_rig import SETUP_FILE
from commander import Commander, torques
from diagnostic_msgs.msg import DiagnosticArray
from harness import LATCHED, NAMESPACE, TIMEOUT_S, Probe, Processes
from interfaces_page import rows_of
from lifecycle_msgs.msg import State
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy
from recorded_run import simulated_run, write_bag
from sensor_msgs.msg import JointState

from worm_model.gait import Gait as PlayedGait
from worm_msgs.action import RunGait
from worm_msgs.msg import Gait, GaitState
from worm_optimizer.nodes.operator_node import operator
from worm_optimizer.operation.bring_up import start_nodes
from worm_optimizer.operation.processes import Process, executable_command
from worm_optimizer.operation.system import MODES, installed_system_file
from worm_optimizer.robot_commands import GaitCommand

# one process runs all, so that they share one graph
pytestmark = pytest.mark.xdist_group("graph")

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


WITHOUT_TF2 = () if find_spec("tf2_msgs") else ("tf",)  # it is not a wheel

ANALYZERS = Path(__file__).parents[2] / "src/worm_optimizer/config/analyzers.yaml"
POLICIES = Path(__file__).parents[2] / "src/worm_driver/security/policies"
ENCLAVES = {policy.name.removesuffix(".policy.xml"): policy for policy in POLICIES.glob("*.xml")}
#: element of a policy, and the query for the nodes' names
RIGHTS = {
    ("topics", "publish"): "get_publisher_names_and_types_by_node",
    ("topics", "subscribe"): "get_subscriber_names_and_types_by_node",
    ("services", "reply"): "get_service_names_and_types_by_node",
    ("services", "request"): "get_client_names_and_types_by_node",
    ("actions", "execute"): "get_service_names_and_types_by_node",
    ("actions", "call"): "get_client_names_and_types_by_node",
}
SEND_GOAL = "/_action/send_goal"

Rights = dict[tuple[str, str], set[str]]


@pytest.fixture(scope="module")
def worm(module_domain: int, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Processes]:
    """Start all nodes of the virtual mode. The last test that uses them ends them."""
    folder = tmp_path_factory.mktemp("graph")
    places = {name: str(folder / name) for name in ("directory", "bag")}
    with Processes(folder) as processes:
        probe = Probe(module_domain)
        start_nodes(processes, installed_system_file().system("virtual", **places))
        driver = Commander(probe)
        probe.wait_for(
            lambda: driver.lifecycle_state() == State.PRIMARY_STATE_ACTIVE, "active driver"
        )
        probe.close()
        yield processes


@pytest.fixture
def graph(worm: Processes, module_domain: int) -> Iterator[Probe]:
    """Return a node of the test in the graph."""
    with closing(Probe(module_domain)) as probe:
        yield probe


def test_topics_services_and_actions_are_those_of_the_documentation(graph):
    """Names, types and quality of service as the running nodes announce them."""
    node = graph.node

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

    absent = ("/", "camera/", *OF_OPERATORS, *WITHOUT_TF2)  # names elsewhere, and no camera
    topics = {name: row for name, row in rows_of("Topics").items() if not name.startswith(absent)}
    graph.wait_for(lambda: set(published()) >= set(topics), "all topics")
    found = {name: kind.replace("/msg", "") for name, kind in published().items()}
    assert found == {name: row[0] for name, row in topics.items()}
    for name, row in topics.items():
        latched = "transient local" in row[3]
        for info in node.get_publishers_info_by_topic(name):
            assert info.qos_profile.reliability is ReliabilityPolicy.RELIABLE
            durability = info.qos_profile.durability
            assert (durability is DurabilityPolicy.TRANSIENT_LOCAL) == latched, name

    services = {n: r for n, r in rows_of("Services").items() if not n.startswith(("~", "driver/"))}
    actions = rows_of("Actions")
    wanted = set(services) | {f"{name}/_action/send_goal" for name in actions}
    graph.wait_for(lambda: set(own(node.get_service_names_and_types())) >= wanted, "all services")
    every = own(node.get_service_names_and_types())
    goals = {n.removesuffix("/_action/send_goal"): k for n, k in every.items() if "send_goal" in n}
    goals = {n: k.replace("/action", "").removesuffix("_SendGoal") for n, k in goals.items()}
    assert goals == {name: row[0] for name, row in actions.items()}
    others = re.compile(
        f".*({COMMON_SERVICES.pattern})|.*/_action.*|driver/(change_state|get_state)"
    )
    plain = {n: k.replace("/srv", "") for n, k in every.items() if not others.fullmatch(n)}
    assert plain == {name: row[0] for name, row in services.items()}


def test_every_status_belongs_to_one_group_of_the_diagnostic_aggregator(graph):
    reported = graph.collect(DiagnosticArray, "/diagnostics")
    content = yaml.safe_load(ANALYZERS.read_text())["analyzers"]["ros__parameters"]
    prefixes = {
        name: part["find_and_remove_prefix"] for name, part in content.items() if name != "path"
    }

    def groups() -> dict[str, list[str]]:
        statuses = {status.name for message in reported for status in message.status}
        return {
            name: [group for group, starts in prefixes.items() if name.startswith(tuple(starts))]
            for name in statuses
        }

    expected = sorted(prefixes.keys() - {"tracker"})  # a virtual robot needs no camera
    graph.wait_for(
        lambda: sorted({g for found in groups().values() for g in found}) == expected, "all groups"
    )
    assert [name for name, found in groups().items() if len(found) != 1] == []


def allowed(enclave: str, node: str) -> Rights:
    """Return the full names that an enclave's policy allows a node."""
    profile = ElementTree.parse(ENCLAVES[enclave]).getroot().find(f".//profile[@node='{node}']")
    assert profile is not None, f"{enclave} has no profile of {node}"
    assert profile.get("ns") == NAMESPACE
    rights: Rights = {right: set() for right in RIGHTS}
    for part in profile:
        (access,) = part.attrib
        assert part.attrib[access] == "ALLOW"
        rights[part.tag, access] |= {_full_name(element.text or "", node) for element in part}
    return rights


def _full_name(name: str, node: str) -> str:
    if name.startswith("~"):
        return f"{NAMESPACE}/{node}{name[1:]}"
    return name if name.startswith("/") else f"{NAMESPACE}/{name}"


def announced(probe: Probe, node: str) -> Rights:
    """Return the full names of a running node."""
    rights: Rights = {right: set() for right in RIGHTS}
    if node not in probe.node.get_node_names():
        return rights
    for (kind, access), query in RIGHTS.items():
        names = {name for name, _ in getattr(probe.node, query)(node, NAMESPACE)}
        if kind == "actions":
            names = {n.removesuffix(SEND_GOAL) for n in names if n.endswith(SEND_GOAL)}
        else:
            names = {name for name in names if "/_action/" not in name}
        rights[kind, access] = names
    return rights


def lacking(probe: Probe, enclave: str, node: str, unused: str = "(?!)") -> list[str]:
    """Return the names of a node that its policy does not allow, when the node has all that the policy allows.

    ``unused`` matches allowed names that the node does not use in this test.
    """
    rights = allowed(enclave, node)

    def missing() -> list[str]:
        found = announced(probe, node)
        return sorted(
            f"{node} has no {kind} {access} {name}"
            for (kind, access), names in rights.items()
            for name in names - found[kind, access]
            if not re.fullmatch(unused, name)
        )

    wait(probe, lambda: not missing(), missing)
    found = announced(probe, node)
    return sorted(
        f"{node} may not {kind} {access} {name}"
        for (kind, access), names in found.items()
        for name in names - rights[kind, access]
    )


def wait(probe: Probe, condition: Callable[[], bool], what: Callable[[], list[str]]) -> None:
    """Wait as the probe does, but fail with the names that are missing at the end."""
    try:
        probe.wait_for(condition, "all that is allowed")
    except AssertionError as error:
        raise AssertionError("; ".join(what())) from error


def test_every_node_of_a_virtual_robot_has_what_its_policy_allows_and_no_more(
    worm: Processes, graph: Probe
):
    people: list[Rights] = []  # names of the operator in each cycle of its gait
    gait = PlayedGait(stroke=0.03, frequency=0.4)
    with operator(NAMESPACE, lambda: None) as person:
        person.deactivate()
        person.activate()
        person.run(GaitCommand(gait, 1), lambda _: people.append(announced(graph, "operator")))
        permitted = allowed("operator", "operator")
        found = lacking(graph, "virtual_robot", "virtual_robot")
        found += lacking(graph, "driver", "driver")
        found += lacking(graph, "driver", "driver_stop")
        found += lacking(graph, "twin", "twin", "/clock|/worm/tf")
        found += lacking(graph, "optimizer", "optimizer", "/clock")
        found += lacking(graph, "recorder", "recorder", "/rosout|/worm/(emergency_stop|tf)")
        found += [
            f"operator may not {kind} {access} {name}"
            for (kind, access), names in people[-1].items()
            for name in names - permitted[kind, access]
        ]
    assert people[-1]["services", "request"] >= {"/worm/driver/change_state"}
    assert people[-1]["actions", "call"] == {"/worm/run_gait"}
    assert found == []


def interrupt(process: Process) -> int:
    """Press Ctrl-C for a node and return its exit status."""
    process.interrupt()
    return process.wait(TIMEOUT_S)


def test_each_node_ends_on_ctrl_c_and_the_driver_stops_the_servos(worm, graph):
    nodes = worm.processes
    states = graph.collect(GaitState, "gait_state", LATCHED)
    joints = graph.collect(JointState, "joint_states")
    assert graph.send_goal(RunGait, "run_gait", LONG_GAIT).accepted
    graph.wait_for(lambda: states and states[-1].cycle >= 1, "running gait")
    graph.wait_for(lambda: joints and abs(joints[-1].velocity[0]) > 0.5, "moving cable servo")

    for name in BYSTANDERS:
        graph.wait_for(lambda name=name: name in graph.node.get_node_names(), f"node {name}")
        assert interrupt(nodes[name]) == 0, name
        cycle = states[-1].cycle
        graph.wait_for(lambda cycle=cycle: states[-1].cycle > cycle, f"cycle without {name}")
        assert states[-1].state == GaitState.RUNNING

    # The recorder continues until the robot rests, see --to-rest.
    nodes["recorder"].interrupt()
    # Within 1.5 s, a second signal belongs to the same Ctrl-C. A cycle is longer.
    cycle = states[-1].cycle
    graph.wait_for(lambda: states[-1].cycle > cycle + 1, "cycle with a recorder asked to end")
    assert nodes["recorder"].exit_code is None
    assert interrupt(nodes["recorder"]) == 0

    assert interrupt(nodes["driver"]) == 0
    assert torques(worm.log_folder / "directory") == [0, 0, 0]
    assert interrupt(nodes["virtual_robot"]) == 0


def test_the_tracker_has_what_its_policy_allows_and_no_more(processes: Processes, probe: Probe):
    processes.start_node("worm_driver", "tracker_node", setup_file=SETUP_FILE)
    assert lacking(probe, "tracker", "tracker") == []


def test_the_player_has_what_its_policy_allows_and_no_more(
    processes: Processes, probe: Probe, tmp_path: Path
):
    bag = write_bag(tmp_path / "bag", simulated_run())
    processes.start_node("worm_model", "play", str(bag), "--loop")
    other = "/worm/(body_length/.*|joint_states|twin/.*|tf|clock|driver/transition_event)|/diagnostics|/rosout"
    assert lacking(probe, "player", "player", other) == []


@pytest.mark.parametrize("enclave", sorted(ENCLAVES))
def test_only_the_operator_may_command(enclave: str):
    root = ElementTree.parse(ENCLAVES[enclave]).getroot()
    calls = {element.text for part in root.iter("actions") if part.get("call") for element in part}
    requested = {
        element.text for part in root.iter("services") if part.get("request") for element in part
    }
    if enclave == "operator":
        assert "run_gait" in calls
        assert "stop" in requested
    else:
        assert calls == requested == set()


@pytest.mark.parametrize("mode", MODES)
def test_every_executable_of_every_mode_is_installed(mode):
    for node in installed_system_file().system(mode, bag="any").nodes:
        assert Path(executable_command(node.package, node.executable)[-1]).is_file()
