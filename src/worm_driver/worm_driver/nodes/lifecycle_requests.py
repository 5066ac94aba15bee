# SPDX-License-Identifier: Apache-2.0
"""Server of the lifecycle requests in a thread of its own.

rclpy (7.1) serves these requests in the node's executor. A transition blocks the executor for seconds. During this time
the middleware stores only ten requests. A request for a transition that is impossible in the present state raises an
exception in the executor, which ends the node. This module answers every request, also during a transition, and
rejects impossible transitions.
"""

import queue
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

from lifecycle_msgs.msg import State
from lifecycle_msgs.srv import ChangeState, GetAvailableTransitions
from rclpy.lifecycle import LifecycleNode
from rclpy.service import Service

from worm_driver.nodes.side_node import SideNode
from worm_driver.nodes.throttled_log import ThrottledLog

_CHANGE = "change_state"
_TRANSITIONS = "get_available_transitions"
_SERVICES = (
    _CHANGE,
    "get_state",
    "get_available_states",
    _TRANSITIONS,
    "get_transition_graph",
)
_PRIMARY_STATES = (
    State.PRIMARY_STATE_UNCONFIGURED,
    State.PRIMARY_STATE_INACTIVE,
    State.PRIMARY_STATE_ACTIVE,
    State.PRIMARY_STATE_FINALIZED,
)
#: s, period of checks for requests during a transition
_PERIOD = 0.005


@dataclass
class _Transition:
    """Transition that waits for its execution in the node's thread."""

    request: ChangeState.Request
    response: ChangeState.Response
    done: threading.Event = field(default_factory=threading.Event)


class LifecycleRequests:
    """Server of a node's lifecycle. Transitions run in the node's thread.

    The services run in a second node (`SideNode`) with its own executor and thread, here called the side node and the
    side thread. The response to a request has ``success`` False if the transition is impossible in the present state,
    or if another transition is in progress. The reason is logged; the log is rate-limited.
    """

    def __init__(self, node: LifecycleNode):
        self._node = node
        self._log = ThrottledLog(node.get_logger())
        self._side = SideNode(node, "lifecycle")
        self._services = {name: self._move(name) for name in _SERVICES}
        self._carry_out: Callable[..., ChangeState.Response] = self._services[_CHANGE].callback
        self._services[_CHANGE].callback = self._on_change
        self._waiting: queue.SimpleQueue[_Transition] = queue.SimpleQueue()
        self._wake = node.create_guard_condition(self._carry_out_waiting)
        self._closing = threading.Event()
        self._rejects_all = False
        self._side.start()

    def reject_all(self) -> None:
        """Reject all further transitions, because the driver ends."""
        self._rejects_all = True

    def close(self) -> None:
        """End the side thread. Transitions that still wait are rejected."""
        self._closing.set()
        self._side.close()

    def _move(self, name: str) -> Service:
        """Move one of the node's services to the side node's executor."""
        services, side = self._node._services, self._side.node
        service = next(s for s in services if s.srv_name.endswith(f"/{name}"))
        services.remove(service)
        service.callback_group = side.default_callback_group
        side.default_callback_group.add_entity(service)
        side._services.append(service)
        return service

    def _on_change(
        self, request: ChangeState.Request, response: ChangeState.Response
    ) -> ChangeState.Response:
        """Pass a transition to the node's thread, and answer other requests meanwhile. Runs in the side thread."""
        if why := self._why_impossible(request):
            return self._reject(response, why)
        transition = _Transition(request, response)
        self._waiting.put(transition)
        self._wake.trigger()
        while not transition.done.wait(_PERIOD):
            if self._closing.is_set():
                return self._reject(response, "the driver ends")
            self._answer_others()
        return response

    def _carry_out_waiting(self) -> None:
        """Execute the waiting transitions. Runs in the node's thread."""
        while not self._waiting.empty():
            transition = self._waiting.get()
            # The state may have changed in the meantime, for example by autostart.
            why = (
                "the driver ends" if self._rejects_all else self._why_impossible(transition.request)
            )
            try:
                if why:
                    self._reject(transition.response, why)
                else:
                    self._carry_out(transition.request, transition.response)
            finally:
                transition.done.set()

    def _why_impossible(self, request: ChangeState.Request) -> str:
        """Return why a transition is impossible in the present state; empty if it is possible."""
        requested = request.transition
        if self._node._state_machine.current_state[0] not in _PRIMARY_STATES:
            return "another transition is in progress"
        offered = self._services[_TRANSITIONS].callback(
            GetAvailableTransitions.Request(), GetAvailableTransitions.Response()
        )
        possible = [description.transition for description in offered.available_transitions]
        # A label takes precedence over the id, as in rclpy.
        if any(
            t.label == requested.label if requested.label else t.id == requested.id
            for t in possible
        ):
            return ""
        names = ", ".join(sorted({t.label for t in possible})) or "none"
        return f"there is no transition {requested.label or requested.id} from the present state, only: {names}"

    def _reject(self, response: ChangeState.Response, why: str) -> ChangeState.Response:
        self._log.error(f"lifecycle request rejected: {why}")
        response.success = False
        return response

    def _answer_others(self) -> None:
        for name, service in self._services.items():
            for request, header in _taken(service):
                response = service.srv_type.Response()
                if name == _CHANGE:
                    self._reject(response, "another transition is in progress")
                else:
                    service.callback(request, response)
                service.send_response(response, header)


def _taken(service: Service) -> Iterator[tuple[Any, Any]]:
    """Yield the waiting requests of a service, with their headers."""
    while True:
        with service.handle:
            request, header = service.handle.service_take_request(service.srv_type.Request)
        if header is None:
            return
        yield request, header
