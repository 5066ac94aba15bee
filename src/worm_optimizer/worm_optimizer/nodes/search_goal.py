# SPDX-License-Identifier: Apache-2.0
"""A margin scan or an optimisation that was asked of the optimizer, which goes on beside all else."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import asdict
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from worm_msgs.action import OptimizeGaits, ScanMargin
from worm_optimizer.nodes.action_goal import ActionGoal
from worm_optimizer.orders import FrontOrder, ScanOrder, SearchResult
from worm_optimizer.search.nsga2 import SearchSettings

_LOOK_S = 0.25
_ANSWER_S = 10.0  # to a cancellation; an optimizer that was started again does not know of the goal


class SearchGoal(ActionGoal):
    """Ends by itself: ``on_end`` gets the result from the thread that spins the node.

    Attributes:
        fraction: of the work that is done.
        wanted: may be set to false from any thread; the search is then cancelled.
    """

    def __init__(
        self, node: Node, order: ScanOrder | FrontOrder, on_end: Callable[[SearchResult], None]
    ) -> None:
        super().__init__(node, *_action_of(order))
        self.fraction = 0.0
        self.wanted = True
        self._on_end = on_end
        self._cancelled_at = math.inf
        clock = Clock(clock_type=ClockType.STEADY_TIME)
        self._timer = node.create_timer(_LOOK_S, self._look, clock=clock)

    def close(self) -> None:
        """Let go of it; the optimizer goes on with what it has begun."""
        self._node.destroy_timer(self._timer)
        super().close()

    def _look(self) -> None:
        if self.done:
            self._end(_result_of(self._message()))
        elif self.answered and not self.possible:
            self._end(SearchResult(success=False, message="the optimizer is not there any more"))
        elif not self.wanted and not self._cancelled:
            self._cancelled_at = time.monotonic()
            self.cancel()
        elif time.monotonic() > self._cancelled_at + _ANSWER_S:
            words = "cancelled; the optimizer does not answer, it may have started again since"
            self._end(SearchResult(success=False, message=words))

    def _end(self, result: SearchResult) -> None:
        self._timer.cancel()
        self._on_end(result)

    def _take(self, feedback: Any) -> None:
        self.fraction = feedback.fraction


def _action_of(order: ScanOrder | FrontOrder) -> tuple[Any, str, Any]:
    if isinstance(order, ScanOrder):
        return ScanMargin, "scan_margin", ScanMargin.Goal(**asdict(order))
    goal = OptimizeGaits.Goal(seed=SearchSettings().seed, **asdict(order))
    return OptimizeGaits, "optimize_gaits", goal


def _result_of(message: Any) -> SearchResult:
    if isinstance(message, OptimizeGaits.Result):
        return SearchResult(message.success, message.message)
    cliff = message.cliff_margin
    cliff_text = (
        f"the cliff is at {1e3 * cliff:.2f} mm"
        if math.isfinite(cliff)
        else "no cliff is among them"
    )
    return SearchResult(
        message.success,
        cliff_text if message.success else message.message,
        tuple(message.margins),
        tuple(message.cost_of_transport),
        cliff,
    )
