# SPDX-License-Identifier: Apache-2.0
"""The whole node graph of system.yaml: Ctrl-C of each node in turn, while a gait runs."""

from pathlib import Path

import pytest
from harness import LATCHED, SERVOS, VirtualWorm, system_file
from sensor_msgs.msg import JointState

from worm_msgs.action import RunGait
from worm_msgs.msg import Gait, GaitState
from worm_optimizer.operation.processes import executable_command
from worm_optimizer.operation.system import MODES

LONG_GAIT = RunGait.Goal(
    gait=Gait(stroke=0.07, frequency=0.4, direction=Gait.FORWARD, margin=0.0), cycles=60
)
BYSTANDERS = ("recorder", "twin", "optimizer")


@pytest.fixture
def worm(processes, probe, tmp_path) -> VirtualWorm:
    """All nodes of the virtual mode, the driver activated."""
    worm = VirtualWorm(processes, probe, tmp_path)
    worm.start()
    worm.activate()
    return worm


def test_each_node_ends_on_ctrl_c_and_the_driver_stops_the_servos(worm, probe):
    states = probe.collect(GaitState, "gait_state", LATCHED)
    joints = probe.collect(JointState, "joint_states")
    assert probe.send_goal(RunGait, "run_gait", LONG_GAIT).accepted
    probe.wait_for(lambda: states and states[-1].cycle >= 1, "running gait")
    probe.wait_for(lambda: joints and abs(joints[-1].velocity[0]) > 0.5, "moving cable servo")

    for name in BYSTANDERS:
        probe.wait_for(lambda name=name: name in probe.node.get_node_names(), f"node {name}")
        assert worm.interrupt(name) == 0, name
        cycle = states[-1].cycle
        probe.wait_for(lambda cycle=cycle: states[-1].cycle > cycle, f"cycle without {name}")
        assert states[-1].state == GaitState.RUNNING

    assert worm.interrupt("driver") == 0
    assert worm.torques() == dict.fromkeys(SERVOS, 0)
    assert worm.interrupt("virtual_robot") == 0


@pytest.mark.parametrize("mode", MODES)
def test_every_executable_of_every_mode_is_installed(mode):
    for node in system_file().system(mode, bag="any").nodes:
        assert Path(executable_command(node.package, node.executable)[-1]).is_file()
