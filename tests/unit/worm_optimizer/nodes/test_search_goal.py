# SPDX-License-Identifier: Apache-2.0
"""A search ends for whoever asked for it, also where its optimizer has forgotten it; node and action are made up."""

from collections.abc import Callable
from types import SimpleNamespace

import pytest

pytest.importorskip("worm_msgs.msg", reason="worm_msgs is not built")

from worm_optimizer.nodes import action_goal, search_goal
from worm_optimizer.nodes.search_goal import SearchGoal
from worm_optimizer.orders import FrontOrder, SearchResult


class Node:
    """Has one timer, for which the test looks."""

    def create_timer(self, period_s: float, look: Callable[[], None], clock: object) -> object:
        self.look = look
        return SimpleNamespace(cancel=lambda: None)


class Handle:
    """A goal whose optimizer does not know of it any more."""

    def __init__(self) -> None:
        self.cancels = 0

    def get_result_async(self) -> object:
        return SimpleNamespace(done=lambda: False)

    def cancel_goal_async(self) -> None:
        self.cancels += 1


def test_a_cancellation_that_nobody_answers_ends_the_search(monkeypatch: pytest.MonkeyPatch):
    client = SimpleNamespace(server_is_ready=lambda: True)
    monkeypatch.setattr(action_goal, "ActionClient", lambda *_: client)
    clock = SimpleNamespace(now=100.0)
    monkeypatch.setattr(search_goal.time, "monotonic", lambda: clock.now)
    node, handle, ends = Node(), Handle(), list[SearchResult]()
    goal = SearchGoal(node, FrontOrder(1), ends.append)
    goal._on_answer(SimpleNamespace(result=lambda: handle))
    clock.now += 1000.0
    node.look()
    assert ends == []  # it may take long
    goal.wanted = False
    node.look()
    node.look()
    assert (handle.cancels, ends) == (1, [])
    clock.now += 11.0
    node.look()
    (end,) = ends
    assert not end.success
    assert "does not answer" in end.message
