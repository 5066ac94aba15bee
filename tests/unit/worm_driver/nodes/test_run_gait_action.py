# SPDX-License-Identifier: Apache-2.0
"""Commands of the action run_gait to the control loop, without the middleware."""

from types import SimpleNamespace
from unittest.mock import MagicMock

import pytest

pytest.importorskip("worm_msgs", reason="the workspace is not built")

from driver_rig import Rig, settings
from rclpy.action import CancelResponse
from rclpy.task import Future

from worm_driver.gait.gait_metrics import RunRecord
from worm_driver.gait.gait_player import Ending
from worm_driver.gait.run_end import HeartbeatMonitor, RunEnd
from worm_driver.nodes import run_gait_action
from worm_driver.nodes.run_gait_action import RunGaitAction

#: s, delay of the control loop. A watchdog of 2 s tolerates it, and the gait is slow enough that the cable follows.
LATE = 0.8
GOAL = SimpleNamespace(goal_id=SimpleNamespace(uuid=b"goal"), is_cancel_requested=True)


@pytest.fixture
def rig() -> Rig:
    """Return a rig in the first cycle of a slow run."""
    return Rig(settings(watchdog=2.0)).play(0.03, 0.2, cycles=50)


@pytest.fixture
def action(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> RunGaitAction:
    """Return the action, with the rig's run as its last one."""
    for name in ("GoalServer", "GoalRejections"):
        monkeypatch.setattr(run_gait_action, name, MagicMock())
    hardware = SimpleNamespace(loop=rig.loop, robot=rig.robot, settings=rig.settings)
    action = RunGaitAction(MagicMock(), MagicMock(), lambda: hardware, lambda: True)
    run = rig.robot.player.run
    action._runs.append(
        run_gait_action._Current(
            GOAL.goal_id.uuid,
            run.number,
            Future(),
            RunRecord(),
            rig.settings.body,
            RunEnd(0, 3, 0.0),
            HeartbeatMonitor(0.0, 0.0),
        )
    )
    return action


def late(rig: Rig) -> None:
    """Let the control loop be late, then run it for longer than a cycle of the gait."""
    rig.clock.now += LATE
    rig.run(6.0)


def test_an_accepted_cancel_is_carried_out_by_a_late_loop(rig: Rig, action: RunGaitAction):
    assert action._on_cancel(GOAL) is CancelResponse.ACCEPT
    late(rig)
    assert rig.robot.player.run.ending is Ending.CANCELLED


def test_a_cancel_before_the_execution_is_carried_out_by_a_late_loop(
    rig: Rig, action: RunGaitAction
):
    execution = action._execute(GOAL)
    execution.send(None)
    late(rig)
    execution.close()
    assert rig.robot.player.run.ending is Ending.CANCELLED


def test_a_run_at_its_end_by_grooves_is_completed_by_a_late_loop(
    rig: Rig, action: RunGaitAction, monkeypatch: pytest.MonkeyPatch
):
    """The action requests this end only once."""
    monkeypatch.setattr(run_gait_action, "is_near_cycle_end", lambda *_: True)
    monkeypatch.setattr(RunEnd, "is_reached", lambda *_: True)
    current = action._runs[-1]
    current.run = rig.robot.player.run
    current.record.positions.append((rig.clock.now, 0.1))
    action._judge(current)
    late(rig)
    assert rig.robot.player.run.ending is Ending.COMPLETED


def test_a_run_that_ended_before_the_driver_was_closed_keeps_its_measurements(
    rig: Rig, action: RunGaitAction, monkeypatch: pytest.MonkeyPatch
):
    current = action._runs[-1]
    rig.loop.submit(rig.robot.cancel)
    ended = rig.run(6.0, until=lambda s: s.player.run.ending is not None).player.run
    current.ended = ended
    speed = 0.004
    current.record.positions += [(ended.onset + 0.1 * k, speed * 0.1 * k) for k in range(80)]
    monkeypatch.setattr(action, "_hardware", lambda: None)
    action.abandon("the driver is cleaned up")
    result = action._finish(MagicMock(), current, current.done.result())
    assert (result.cycles_completed, result.speed) == (1, pytest.approx(speed))
