# SPDX-License-Identifier: Apache-2.0
"""Keeps a lifecycle node alive that is asked for a transition which its state does not have.

rclpy (7.1) raises within its own service callback then, out of the executor, and the node ends with a traceback.
"""

from typing import Any

from lifecycle_msgs.srv import ChangeState, GetAvailableTransitions
from rclpy.lifecycle import LifecycleNode


def refuse_impossible_transitions(node: LifecycleNode) -> None:
    """Has the node's service change_state answer such requests with success False, and the log say why."""
    services = {service.srv_name.rsplit("/", 1)[-1]: service for service in node.services}
    offered, change = services["get_available_transitions"].callback, services["change_state"]
    carry_out = change.callback

    def checked(request: ChangeState.Request, response: ChangeState.Response) -> Any:
        asked = request.transition
        available = offered(
            GetAvailableTransitions.Request(), GetAvailableTransitions.Response()
        ).available_transitions
        possible = [description.transition for description in available]
        # A label counts before the number, as in rclpy.
        if any(t.label == asked.label if asked.label else t.id == asked.id for t in possible):
            return carry_out(request, response)
        names = ", ".join(sorted({t.label for t in possible})) or "none"
        node.get_logger().error(
            f"refused: there is no transition {asked.label or asked.id} from the present state, only: {names}"
        )
        response.success = False
        return response

    change.callback = checked
