# SPDX-License-Identifier: Apache-2.0
"""A search ends for its client, also if its optimizer has lost it; node and action are fakes."""

from collections.abc import Callable
from types import SimpleNamespace

import pytest

pytest.importorskip("worm_msgs.msg", reason="worm_msgs is not built")

from worm_optimizer.nodes import action_goal
from worm_optimizer.nodes.search_goal import SearchGoal
from worm_optimizer.robot_commands import FrontRequest, SearchResult


class Node:
    """Fake node with one timer, which the test triggers."""

    def create_timer(self, period_s: float, look: Callable[[], None], clock: object) -> object:
        self.look = look
        return SimpleNamespace(cancel=lambda: None)

    def create_subscription(self, *_: object) -> None:
        """Do nothing, as no goal is rejected in this test."""


class Handle:
    """Accepted goal without a result."""

    accepted = True

    def get_result_async(self) -> object:
        return SimpleNamespace(done=lambda: False)


def test_an_optimizer_that_has_ended_ends_the_search(monkeypatch: pytest.MonkeyPatch):
    client = SimpleNamespace(ready=True)
    client.server_is_ready = lambda: client.ready
    monkeypatch.setattr(action_goal, "ActionClient", lambda *_: client)
    node, ends = Node(), list[SearchResult]()
    goal = SearchGoal(node, FrontRequest(1), ends.append)
    goal._on_answer(SimpleNamespace(result=Handle))
    node.look()
    assert ends == []
    client.ready = False
    node.look()
    (end,) = ends
    assert not end.success
