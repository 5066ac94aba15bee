# SPDX-License-Identifier: Apache-2.0
"""Calls of the operator when responses get lost; the services are fakes."""

import pytest
from lifecycle_msgs.msg import State
from lifecycle_msgs.srv import GetState
from rclpy.action import ActionServer
from rclpy.task import Future

from worm_model.gait import Gait
from worm_msgs.action import RunGait
from worm_optimizer.nodes import robot_client
from worm_optimizer.nodes.operator_node import operator
from worm_optimizer.nodes.robot_client import OperatorError
from worm_optimizer.robot_commands import GaitCommand


class Service:
    """Client of a service that loses its first responses."""

    def __init__(self, kind, lost: int) -> None:
        self._kind, self._lost = kind, lost
        self.calls = 0

    def service_is_ready(self) -> bool:
        return True

    def call_async(self, _request) -> Future:
        self.calls += 1
        future = Future()
        if self.calls > self._lost:
            future.set_result(self._answer())
        return future

    def _answer(self):
        response = self._kind.Response()
        if self._kind is GetState:
            response.current_state = State(id=State.PRIMARY_STATE_ACTIVE, label="active")
        else:
            response.success = True
        return response


@pytest.fixture
def node(monkeypatch, ros_domain):
    monkeypatch.setenv("ROS_DOMAIN_ID", str(ros_domain))
    monkeypatch.setattr(robot_client, "CALL_TIMEOUT_S", 0.1)
    with operator("/worm", lambda: None) as node:
        yield node


@pytest.fixture
def services(monkeypatch, node):
    """Let every client lose a given number of responses, and count the clients of each name."""

    def make(lost: int) -> dict[str, list[Service]]:
        made: dict[str, list[Service]] = {}

        def create_client(kind, name):
            made.setdefault(name, []).append(Service(kind, lost))
            return made[name][-1]

        monkeypatch.setattr(node, "create_client", create_client)
        return made

    return make


def test_an_invalid_domain_is_reported(monkeypatch):
    monkeypatch.setenv("ROS_DOMAIN_ID", "seven")
    with pytest.raises(OperatorError, match="ROS_DOMAIN_ID"), operator("/worm", lambda: None):
        pass


def test_a_call_that_changes_nothing_more_is_made_again_by_the_same_client(node, services):
    made = services(lost=1)
    node.activate()  # the driver is active: only its state is requested, three times
    node.stop()
    node.stop()
    assert {name: len(clients) for name, clients in made.items()} == {
        "driver/get_state": 1,
        "stop": 1,
    }
    assert made["driver/get_state"][0].calls == 4
    assert made["stop"][0].calls == 3


def test_two_answers_that_are_lost_are_an_error(node, services):
    made = services(lost=9)
    with pytest.raises(OperatorError, match="no answer from stop within"):
        node.stop()
    assert made["stop"][0].calls == 2


def test_a_transition_is_not_requested_twice(node, services):
    made = services(lost=1)
    with pytest.raises(OperatorError, match="no answer from driver/change_state"):
        node.deactivate()
    assert made["driver/change_state"][0].calls == 1


@pytest.mark.parametrize(
    ("command", "state"),
    [
        (lambda node: node.activate(), State.PRIMARY_STATE_INACTIVE),
        (lambda node: node.deactivate(), State.PRIMARY_STATE_ACTIVE),
        (lambda node: node.home(), State.PRIMARY_STATE_INACTIVE),
        (lambda node: node.reboot(), State.PRIMARY_STATE_INACTIVE),
        (
            lambda node: node.run(GaitCommand(Gait(0.05, 0.2), cycles=1), print),
            State.PRIMARY_STATE_ACTIVE,
        ),
    ],
    ids=["activate", "deactivate", "home", "reboot", "run"],
)
def test_nothing_is_sent_that_two_drivers_would_execute(
    node, probe, services, monkeypatch, command, state
):
    monkeypatch.setattr(robot_client, "ANNOUNCED_S", 0.1)
    monkeypatch.setattr(node, "_state", lambda: State(id=state))
    made = services(lost=0)
    for _ in range(2):
        ActionServer(probe.node, RunGait, "run_gait", lambda _: None)
    service = "/worm/run_gait/_action/send_goal"
    probe.wait_for(lambda: node.count_services(service) == 2, "two drivers")
    with pytest.raises(OperatorError, match="/worm has 2 drivers"):
        command(node)
    assert made == {}
    node.stop()  # which is sent to both
    assert made["stop"][0].calls == 1
