# SPDX-License-Identifier: Apache-2.0
"""SROS 2 policies compared with the topics, services and actions of the nodes:

enough for each, and no more (for people: enough).
"""

import re
from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree

import pytest
from camera_rig import SETUP_FILE
from harness import NAMESPACE, Probe, Processes, VirtualWorm
from recorded_run import simulated_run, write_bag

from worm_model.gait import Gait
from worm_optimizer.nodes.operator_node import operator
from worm_optimizer.robot_commands import GaitCommand

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
    processes: Processes, probe: Probe, tmp_path: Path
):
    worm = VirtualWorm(processes, probe, tmp_path)
    worm.start()
    processes.start_node("worm_model", "watch")
    people: list[Rights] = []  # names of the operator in each cycle of its gait
    gait = Gait(stroke=0.03, frequency=0.4)
    with operator(worm.system.namespace, lambda: None) as person:
        person.deactivate()
        person.activate()
        person.run(GaitCommand(gait, 1), lambda _: people.append(announced(probe, "operator")))
        permitted = allowed("operator", "operator")
        found = lacking(probe, "virtual_robot", "virtual_robot")
        found += lacking(probe, "driver", "driver")
        found += lacking(probe, "driver", "driver_stop")
        found += lacking(probe, "twin", "twin", "/clock")
        found += lacking(probe, "optimizer", "optimizer", "/clock")
        found += lacking(probe, "recorder", "recorder", "/rosout|/worm/emergency_stop")
        found += lacking(probe, "recorder", "watch")
        found += [
            f"operator may not {kind} {access} {name}"
            for (kind, access), names in people[-1].items()
            for name in names - permitted[kind, access]
        ]
    assert people[-1]["services", "request"] >= {"/worm/driver/change_state"}
    assert people[-1]["actions", "call"] == {"/worm/run_gait"}
    assert found == []


def test_the_tracker_has_what_its_policy_allows_and_no_more(processes: Processes, probe: Probe):
    processes.start_node("worm_driver", "tracker_node", setup_file=SETUP_FILE)
    assert lacking(probe, "tracker", "tracker", ".*/compressed") == []


def test_the_player_has_what_its_policy_allows_and_no_more(
    processes: Processes, probe: Probe, tmp_path: Path
):
    bag = write_bag(tmp_path / "bag", simulated_run())
    processes.start_node("worm_model", "play", str(bag), "--loop")
    other = "/worm/(body_length/.*|joint_states|twin/.*|clock|driver/transition_event)|/diagnostics|/rosout"
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
