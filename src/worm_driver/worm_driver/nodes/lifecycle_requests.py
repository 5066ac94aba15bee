# SPDX-License-Identifier: Apache-2.0
"""Answers every lifecycle request, also in a flood and while a transition takes its time.

rclpy (7.1) serves these requests in the node's executor, which a transition blocks for seconds, while the middleware
stores ten of them and drops the others. It also raises out of the executor for a transition that the present state
does not have, and the node ends with a traceback.
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
#: s between two looks for requests while a transition takes its time
_LOOK = 0.005


@dataclass
class _Transition:
    """A transition that the node's thread is to carry out."""

    request: ChangeState.Request
    response: ChangeState.Response
    done: threading.Event = field(default_factory=threading.Event)


class LifecycleRequests:
    """Serves a node's lifecycle in a thread of its own; transitions are carried out in the node's.

    A change that the state does not have, or that comes while another one is carried out, is answered with success
    False; the log says why, at most once a second.
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
        self._refuses = False
        self._side.start()

    def refuse(self) -> None:
        """Carry no transition out from now on: the driver ends."""
        self._refuses = True

    def close(self) -> None:
        """End the thread; a change that still waits is answered with success False."""
        self._closing.set()
        self._side.close()

    def _move(self, name: str) -> Service:
        """Have the side node's executor serve one of the node's services."""
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
        """In the side thread: pass a change on, and answer whatever else comes until it is carried out."""
        if why := self._why_impossible(request):
            return self._reject(response, why)
        transition = _Transition(request, response)
        self._waiting.put(transition)
        self._wake.trigger()
        while not transition.done.wait(_LOOK):
            if self._closing.is_set():
                return self._reject(response, "the driver ends")
            self._answer_others()
        return response

    def _carry_out_waiting(self) -> None:
        """In the node's thread."""
        while not self._waiting.empty():
            transition = self._waiting.get()
            # The state may be another one by now, as where the driver has activated itself.
            why = "the driver ends" if self._refuses else self._why_impossible(transition.request)
            try:
                if why:
                    self._reject(transition.response, why)
                else:
                    self._carry_out(transition.request, transition.response)
            finally:
                transition.done.set()

    def _why_impossible(self, request: ChangeState.Request) -> str:
        """Return why the present state does not have a transition; empty where it has."""
        asked = request.transition
        if self._node._state_machine.current_state[0] not in _PRIMARY_STATES:
            return "another transition is being carried out"
        offered = self._services[_TRANSITIONS].callback(
            GetAvailableTransitions.Request(), GetAvailableTransitions.Response()
        )
        possible = [description.transition for description in offered.available_transitions]
        # A label counts before the number, as in rclpy.
        if any(t.label == asked.label if asked.label else t.id == asked.id for t in possible):
            return ""
        names = ", ".join(sorted({t.label for t in possible})) or "none"
        return f"there is no transition {asked.label or asked.id} from the present state, only: {names}"

    def _reject(self, response: ChangeState.Response, why: str) -> ChangeState.Response:
        self._log.error(f"refused: {why}")
        response.success = False
        return response

    def _answer_others(self) -> None:
        for name, service in self._services.items():
            for request, header in _taken(service):
                response = service.srv_type.Response()
                if name == _CHANGE:
                    self._reject(response, "another transition is being carried out")
                else:
                    service.callback(request, response)
                service.send_response(response, header)


def _taken(service: Service) -> Iterator[tuple[Any, Any]]:
    """The requests that wait at a service, and their headers."""
    while True:
        with service.handle:
            request, header = service.handle.service_take_request(service.srv_type.Request)
        if header is None:
            return
        yield request, header
