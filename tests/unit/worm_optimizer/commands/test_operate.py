# SPDX-License-Identifier: Apache-2.0
"""The command operate, as far as it needs no robot."""

from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace

import pytest

from worm_model.errors import InputError
from worm_model.run import Activity
from worm_msgs.conditions import LEVEL, Conditions
from worm_msgs.gait import Gait
from worm_optimizer.commands import operate, operate_run
from worm_optimizer.nodes.robot_client import OperatorError
from worm_optimizer.robot_commands import GaitCommand, RunResult


class Robot:
    """Fake operator of a robot with or without an optimizer, which assumes conditions."""

    def __init__(self, *, has_optimizer: bool) -> None:
        self.has_optimizer = lambda: has_optimizer
        self.parameters: dict[str, float] = {}

    def set_model_parameters(self, values: dict[str, float]) -> None:
        self.parameters = values

    def conditions(self) -> Conditions:
        return Conditions(slope_deg=self.parameters.get("slope_deg", 0.0), tether_n=1.0)


def options_of(*arguments: str):
    return operate._parser().parse_args(["run", *arguments])


def test_only_the_given_conditions_are_set_and_those_that_hold_are_returned():
    robot = Robot(has_optimizer=True)
    found = operate_run.conditions_of(robot, options_of("--slope", "20"), print)
    assert robot.parameters == {"slope_deg": 20.0}
    assert found == Conditions(slope_deg=20.0, tether_n=1.0)
    operate_run.conditions_of(robot, options_of("--slope", "0", "--distance", "0.1"), print)
    assert robot.parameters == {"slope_deg": 0.0}


def test_without_an_optimizer_the_conditions_are_those_of_the_options():
    robot = Robot(has_optimizer=False)
    assert operate_run.conditions_of(robot, options_of("--tether", "2"), print) == Conditions(
        tether_n=2
    )
    assert operate_run.conditions_of(robot, options_of(), print) == LEVEL
    assert robot.parameters == {}


def test_a_run_without_a_complete_cycle_names_its_recording():
    result = RunResult(Gait(0.05, 0.2), False, "stopped")
    assert "bags/run" in operate_run._result_text(result, Path("bags/run"))
    assert operate_run._result_text(result, None) == "stopped"


@pytest.mark.parametrize(
    ("state", "emergency_stop", "error"),
    [
        (Activity.IDLE, False, InputError),
        (Activity.IDLE, True, OperatorError),
        (Activity.INACTIVE, False, OperatorError),
    ],
)
def test_a_gait_that_a_ready_driver_rejects_is_bad_input(state, emergency_stop, error):
    result = RunResult(Gait(0.2, 0.2), False, "rejected: because")
    run = SimpleNamespace(rejected=True, result=result)
    driver = SimpleNamespace(state=state, emergency_stop=emergency_stop)
    robot = SimpleNamespace(
        started=lambda _: nullcontext(run),
        follow=lambda *_: True,
        current_snapshot=lambda: SimpleNamespace(driver=driver),
    )
    with pytest.raises(error, match="because"):
        operate_run.attended(robot, GaitCommand(result.gait, 1), print)
