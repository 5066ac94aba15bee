# SPDX-License-Identifier: Apache-2.0
"""Searches and identifications in the background, one of each; worker, optimizer and library are fakes."""

import asyncio
from collections.abc import Callable, Sequence
from pathlib import Path
from types import SimpleNamespace

import pytest

pytest.importorskip("worm_msgs.msg", reason="worm_msgs is not built")

from worm_model.errors import InputError
from worm_model.parameters import PAPER, ParameterError, ParameterFile, write_parameter_file
from worm_optimizer.console.console_state import ConsoleState, new_notices
from worm_optimizer.console.control import ConsoleControl
from worm_optimizer.console.studies import Studies
from worm_optimizer.nodes.service_caller import OperatorError
from worm_optimizer.robot_commands import FrontRequest, ScanRequest, SearchResult

SCAN, FRONT = ScanRequest(1, 0.0, 0.004, 0.001), FrontRequest(1)


class Goal:
    def __init__(self) -> None:
        self.closed = False

    def close(self) -> None:
        self.closed = True


class Node:
    """Fake operator whose nodes accept parameters, unless it is ``rejecting``."""

    def __init__(self) -> None:
        self.goals: list[Goal] = []
        self.ends: list[Callable[[SearchResult], None]] = []
        self.parameters: list[dict[str, object]] = []
        self.rejecting = False

    def search(self, order: object, on_end: Callable[[SearchResult], None]) -> Goal:
        self.goals.append(Goal())
        self.ends.append(on_end)
        return self.goals[-1]

    def set_model_parameters(self, values: dict[str, object]) -> None:
        if self.rejecting:
            raise OperatorError("rejected")
        self.parameters.append(values)


class RobotWorker:
    """Fake worker that executes commands immediately."""

    def __init__(self, node: Node) -> None:
        self.node, self.free = node, True
        self.results: list[str] = []

    def submit(self, description: str, command: Callable[[Node], str]) -> bool:
        if self.free:
            self.results.append(command(self.node))
        return self.free


class Library:
    """Fake library whose identification ends when the test releases it."""

    def __init__(self) -> None:
        self.release = asyncio.Event()
        self.failure = ""

    async def identify(
        self, names: Sequence[str], parameter_file: str, progress: Callable[[str], None]
    ) -> str:
        progress("locomotion: 40%")
        await self.release.wait()
        if self.failure:
            raise InputError(self.failure)
        return "identified_1.yaml"


@pytest.fixture
def bench() -> SimpleNamespace:
    node = Node()
    worker, library = RobotWorker(node), Library()
    control = ConsoleControl("desk", lambda: 0.0, lambda *_: None, 5.0)
    fronts = {1: ["a gait"]}
    state = ConsoleState(worker, control, library, PAPER, "", new_notices(), fronts)
    return SimpleNamespace(
        node=node, worker=worker, library=library, state=state, studies=Studies(state)
    )


def test_a_scan_runs_until_its_end_and_is_stored(bench: SimpleNamespace):
    assert bench.studies.search(SCAN)
    assert bench.studies.searching == "margin scan"
    assert not bench.studies.search(FRONT)
    found = SearchResult(True, "the cliff is at 3.40 mm", (0.0, 0.001), (50.0, 60.0), 0.0034)
    bench.node.ends[0](found)
    assert bench.studies.searching == ""
    assert bench.studies.scan is found
    assert bench.state.notices[-1].text == "margin scan: the cliff is at 3.40 mm"
    assert bench.state.fronts
    assert bench.studies.search(FRONT)
    assert bench.node.goals[0].closed


def test_a_new_front_discards_the_gaits_of_the_former_one(bench: SimpleNamespace):
    assert bench.studies.search(FRONT)
    bench.node.ends[0](SearchResult(True, "margin 2.50 mm"))
    assert bench.state.fronts == {}


def test_a_failed_search_changes_nothing_and_is_reported_as_an_error(bench: SimpleNamespace):
    bench.studies.search(FRONT)
    bench.node.ends[0](SearchResult(False, "margin: -1.0 m"))
    assert bench.state.fronts
    assert not bench.state.notices[-1].good


def test_a_busy_worker_starts_no_search(bench: SimpleNamespace):
    bench.worker.free = False
    assert not bench.studies.search(SCAN)
    assert bench.studies.searching == ""


def test_an_identification_reports_its_progress_and_its_file(bench: SimpleNamespace):
    async def identify() -> None:
        assert bench.studies.identify(["run"])
        assert not bench.studies.identify(["run"])
        await asyncio.sleep(0)
        assert bench.studies.identifying == "identification, locomotion: 40%"
        bench.library.release.set()
        await bench.studies._task

    asyncio.run(identify())
    assert bench.studies.identifying == ""
    assert bench.studies.identified == "identified_1.yaml"
    assert "identified_1.yaml" in bench.state.notices[-1].text


@pytest.mark.parametrize(("failure", "reason"), [("no run", "no run"), ("", "cancelled")])
def test_a_failed_or_cancelled_identification_reports_the_reason(
    bench: SimpleNamespace, failure: str, reason: str
):
    async def identify() -> None:
        bench.studies.identify(["run"])
        await asyncio.sleep(0)
        bench.library.failure = failure
        if failure:
            bench.library.release.set()
        else:
            bench.studies.cancel_identification()
        await bench.studies._task

    asyncio.run(identify())
    assert bench.studies.identifying == bench.studies.identified == ""
    assert bench.state.notices[-1].text == f"identification: {reason}"


def test_both_nodes_and_the_pages_use_new_parameters(bench: SimpleNamespace, tmp_path: Path):
    file = tmp_path / "robot.yaml"
    write_parameter_file(file, ParameterFile(PAPER))
    assert bench.studies.set_parameter_file(str(file))
    assert bench.node.parameters == [{"parameter_file": str(file)}]
    assert (bench.state.parameter_file, bench.state.fronts) == (str(file), {})
    assert bench.studies.initial_file == ""
    assert bench.studies.set_parameter_file("")
    assert bench.worker.results[-1] == "twin and optimizer use the paper’s values"


def test_after_a_rejection_the_pages_use_the_former_parameters(
    bench: SimpleNamespace, tmp_path: Path
):
    file = tmp_path / "robot.yaml"
    with pytest.raises(ParameterError):
        bench.studies.set_parameter_file(str(file))
    write_parameter_file(file, ParameterFile(PAPER))
    bench.node.rejecting = True
    with pytest.raises(OperatorError):
        bench.studies.set_parameter_file(str(file))
    assert bench.state.parameter_file == ""
