# SPDX-License-Identifier: Apache-2.0
"""The emergency stop of the driver, without the middleware."""

from pathlib import Path
from unittest.mock import MagicMock

import pytest

pytest.importorskip("worm_msgs", reason="the workspace is not built")

from driver_rig import Rig

from worm_driver.control.emergency import EmergencyLatch
from worm_driver.gait.gait_player import Phase
from worm_driver.nodes import stop_services
from worm_driver.nodes.stop_services import StopServices


def test_the_emergency_stop_does_not_depend_on_the_graph(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
):
    for name in ("SideNode", "IdentifiedSubscription", "_ControlTopics"):
        monkeypatch.setattr(stop_services, name, MagicMock())
    rig = Rig()
    rig.activate()
    rig.start(0.03, 0.2, cycles=50)
    rig.run(10.0, until=lambda s: s.player.phase is Phase.RUNNING)
    latch, reject_goals = EmergencyLatch(tmp_path), MagicMock()
    services = StopServices(MagicMock(), lambda: rig, latch, reject_goals, MagicMock(), MagicMock())
    graph = services._side.node.get_publishers_info_by_topic
    graph.side_effect = RuntimeError("no graph")
    services._on_emergency(b"publisher", 1, True)
    rig.run(0.1)
    assert latch.on
    reject_goals.assert_called_once()
    assert rig.robot.holding
