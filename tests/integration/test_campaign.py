# SPDX-License-Identifier: Apache-2.0
"""The campaign on the virtual robot, with real processes: two short gaits instead of three."""

from pathlib import Path

import pytest

from worm_model.gait import Gait
from worm_optimizer.operation.campaign_runs import run_gaits
from worm_optimizer.operation.system import Robot, installed_system_file
from worm_optimizer.report.agreement import agreements
from worm_optimizer.report.agreement import orders as orders_of
from worm_optimizer.report.recordings import read_recorded_gaits
from worm_optimizer.robot_commands import GaitCommand

GAITS = {"slow": Gait(0.06, 0.38), "fast": Gait(0.08, 0.4)}


@pytest.mark.night
@pytest.mark.timeout(300)
def test_each_gait_has_a_recording_of_its_own_that_agrees(ros_domain: int, tmp_path: Path):
    (tmp_path / "logs").mkdir()
    robot = Robot(installed_system_file(), "virtual", {"directory": str(tmp_path / "robot")})
    orders = {name: GaitCommand(gait, 5) for name, gait in GAITS.items()}
    run_gaits(robot, orders, tmp_path, tmp_path / "logs", say=print)

    recorded = read_recorded_gaits([tmp_path / name for name in GAITS], "", print)
    assert [gait.name for gait in recorded] == list(GAITS)
    for gait, played in zip(recorded, GAITS.values(), strict=True):
        assert gait.gait == played
        assert gait.played.cycles == 5
        assert gait.averaged_cycles == (3, 5)
        assert gait.missing == ()
        assert [row.measured.value for row in agreements(gait)] == pytest.approx(
            [row.expected.value for row in agreements(gait)], rel=0.2
        )
    assert orders_of(recorded)["speed"][0] is True
