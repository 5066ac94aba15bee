# SPDX-License-Identifier: Apache-2.0
"""A gait that fails is run once more, and a failure names the load; the operator is a fake."""

import os
from pathlib import Path

import pytest

from worm_model.gait import Gait
from worm_optimizer.nodes.operator_node import GaitFailedError
from worm_optimizer.operation.bring_up import Session
from worm_optimizer.operation.processes import ProcessGroup
from worm_optimizer.operation.system import System
from worm_optimizer.robot_commands import GaitCommand, RunProgress

GAIT = Gait(0.07, 0.2)


class Operator:
    """Fake operator whose first gaits fail, and which records the requests."""

    def __init__(self, failures: int, late_cycles: int = 0) -> None:
        self.failures, self.late_cycles = failures, late_cycles
        self.requests: list[str] = []

    def run(self, order: GaitCommand, progress) -> None:
        assert order == GaitCommand(GAIT, 5)
        self.requests.append("run")
        progress(RunProgress(1, 0.0, 0.0, 0.0, 0.0))
        if self.failures:
            self.failures -= 1
            raise GaitFailedError("the gait failed: fault: servo 1 gives no state")

    def activate(self) -> None:
        self.requests.append("activate")

    def deactivate(self) -> None:
        self.requests.append("deactivate")


@pytest.fixture
def idle(monkeypatch):
    monkeypatch.setattr(os, "getloadavg", lambda: (0.3, 0.3, 0.3))


def run(operator: Operator, folder: Path) -> list[str]:
    reported: list[str] = []
    system = System("worm", ())
    Session(ProcessGroup(folder), operator, system, reported.append).run_gait(GaitCommand(GAIT, 5))
    return reported


def test_a_gait_that_succeeds_is_run_once(idle, tmp_path):
    operator = Operator(0)
    assert run(operator, tmp_path) == ["cycle 1 of 5"]
    assert operator.requests == ["run"]


def test_a_gait_that_fails_is_run_once_more_which_is_reported(idle, tmp_path):
    operator = Operator(1)
    reported = run(operator, tmp_path)
    assert "the gait failed: fault: servo 1 gives no state: once more" in reported
    assert operator.requests == ["run", "deactivate", "activate", "run"]


def test_a_gait_that_fails_twice_has_failed(idle, tmp_path):
    with pytest.raises(GaitFailedError, match=r"gives no state, twice$"):
        run(Operator(2), tmp_path)


def test_a_failure_names_the_load_and_the_late_cycles(monkeypatch, tmp_path):
    monkeypatch.setattr(os, "getloadavg", lambda: (9.0, 1.0, 1.0))
    monkeypatch.setattr(os, "cpu_count", lambda: 2)
    expected = r"twice \(the computer was busy: load average 9.0 on 2 processors, 31 cycles of the driver late\)"
    with pytest.raises(GaitFailedError, match=expected):
        run(Operator(2, late_cycles=31), tmp_path)
