# SPDX-License-Identifier: Apache-2.0
"""A gait that fails is run once more; the operator is a fake."""

from pathlib import Path

import pytest

from worm_model.gait import Gait
from worm_optimizer.nodes.operator_node import GaitFailedError
from worm_optimizer.operation.bring_up import Session
from worm_optimizer.operation.processes import ProcessGroup
from worm_optimizer.robot_commands import GaitCommand, RunProgress

COMMAND = GaitCommand(Gait(0.07, 0.2), 5)
FAILURE = "the gait failed: fault: servo 1 gives no state"


class Operator:
    """Fake operator whose first gaits fail, and which records the requests."""

    def __init__(self, failures: int) -> None:
        self.failures = failures
        self.requests: list[str] = []
        self.activate = lambda: self.requests.append("activate")
        self.deactivate = lambda: self.requests.append("deactivate")

    def run(self, command: GaitCommand, progress) -> None:
        assert command == COMMAND
        self.requests.append("run")
        for _ in range(2):
            progress(RunProgress(1, 0.0, 0.0, 0.0, 2.0))
        if len(self.requests) <= self.failures:
            raise GaitFailedError(FAILURE)


@pytest.mark.parametrize("failures", [0, 1])
def test_a_gait_that_fails_is_run_once_more_which_is_reported(failures: int, tmp_path: Path):
    operator, reported = Operator(failures), []
    Session(ProcessGroup(tmp_path), operator, reported.append).run_gait(COMMAND)
    again = ["deactivate", "activate", "run"] * failures
    assert operator.requests == ["run", *again]
    progress = "cycle 1, +0.0 mm, +0.0 grooves, 2.00 W"
    assert reported == [progress, *[f"{FAILURE}: once more", progress] * failures]


def test_a_gait_that_fails_twice_has_failed(tmp_path: Path):
    with pytest.raises(GaitFailedError, match=FAILURE):
        Session(ProcessGroup(tmp_path), Operator(9), print).run_gait(COMMAND)
