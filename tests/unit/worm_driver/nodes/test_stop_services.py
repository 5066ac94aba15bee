# SPDX-License-Identifier: Apache-2.0
"""The emergency stop of the driver, without the middleware."""

from pathlib import Path
from unittest.mock import MagicMock

import pytest

pytest.importorskip("worm_msgs", reason="the workspace is not built")

from driver_rig import Rig
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from worm_driver.control.emergency import EmergencyLatch
from worm_driver.gait.gait_player import Phase
from worm_driver.nodes import stop_services
from worm_driver.nodes.stop_services import StopServices


def test_a_stop_holds_and_a_reset_clears_it_unless_it_is_still_demanded(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
):
    for name in ("Node", "threading"):
        monkeypatch.setattr(stop_services, name, MagicMock())
    rig = Rig()
    rig.activate()
    rig.start(0.03, 0.2, cycles=50)
    rig.run(10.0, until=lambda s: s.player.phase is Phase.RUNNING)
    latch, reject_goals = EmergencyLatch(tmp_path), MagicMock()
    services = StopServices(MagicMock(), lambda: rig, latch, reject_goals, MagicMock())
    services._on_emergency(Bool(data=True))
    rig.run(0.1)
    assert latch.on
    reject_goals.assert_called_once()
    assert rig.robot.holding

    def reset() -> bool:
        return services._on_reset(Trigger.Request(), Trigger.Response()).success

    assert not reset()
    services._on_emergency(Bool(data=False))
    assert latch.on
    assert reset()
    assert not latch.on
