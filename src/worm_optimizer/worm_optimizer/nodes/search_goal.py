# SPDX-License-Identifier: Apache-2.0
"""Client of one goal of the optimizer node: a margin scan or the computation of a front."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from worm_msgs.action import OptimizeGaits, ScanMargin
from worm_optimizer.nodes.action_goal import ActionGoal
from worm_optimizer.robot_commands import FrontRequest, ScanRequest, SearchResult

_LOOK_S = 0.25  # period of the checks for the result, s


class SearchGoal(ActionGoal):
    """Goal of a margin scan or of the computation of a front.

    Args:
        node: the client's node.
        request: the margin scan or the front to compute.
        on_end: called once with the result, in the thread that spins the node.
    """

    def __init__(
        self,
        node: Node,
        request: ScanRequest | FrontRequest,
        on_end: Callable[[SearchResult], None],
    ) -> None:
        super().__init__(node, *_action_of(request))
        self._on_end = on_end
        clock = Clock(clock_type=ClockType.STEADY_TIME)
        self._timer = node.create_timer(_LOOK_S, self._look, clock=clock)

    def close(self) -> None:
        """Stop waiting for the result and free the client. The optimizer finishes a computation that has begun."""
        self._node.destroy_timer(self._timer)
        super().close()

    def _look(self) -> None:
        if self.done:
            rejected = SearchResult(success=False, message=self.rejection)
            self._end(rejected if self.rejected else _result_of(self._message()))
        elif self.rejected:
            return  # The reason has not arrived. Then, or without it after `REASON_S`, `done` becomes True.
        elif self.answered and not self.possible:
            self._end(SearchResult(success=False, message="the optimizer has ended"))

    def _end(self, result: SearchResult) -> None:
        self._timer.cancel()
        self._on_end(result)


def _action_of(request: ScanRequest | FrontRequest) -> tuple[Any, str, Any]:
    if isinstance(request, ScanRequest):
        return ScanMargin, "scan_margin", ScanMargin.Goal(**asdict(request))
    from worm_optimizer.search.search_settings import Settings  # imports the kernel

    goal = OptimizeGaits.Goal(seed=Settings().seed, **asdict(request))
    return OptimizeGaits, "optimize_gaits", goal


def _result_of(message: Any) -> SearchResult:
    if isinstance(message, OptimizeGaits.Result):
        return SearchResult(message.success, message.message)
    cliff = message.cliff_margin
    cliff_text = (
        f"the cliff is at {1e3 * cliff:.2f} mm" if math.isfinite(cliff) else "the scan has no cliff"
    )
    return SearchResult(
        message.success,
        cliff_text if message.success else message.message,
        tuple(message.margins),
        tuple(message.cost_of_transport),
        cliff,
    )
