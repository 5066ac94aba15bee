# SPDX-License-Identifier: Apache-2.0
"""Searches and identifications go on beside all else, one of each; worker, optimizer and shelf are made up."""

import asyncio
from collections.abc import Callable, Sequence
from pathlib import Path
from types import SimpleNamespace

import pytest

pytest.importorskip("worm_msgs.msg", reason="worm_msgs is not built")

from worm_model.errors import InputError
from worm_model.parameters import PAPER, ParameterError, ParameterFile, write_parameter_file
from worm_optimizer.console.control import Control
from worm_optimizer.console.hub import Hub, new_words
from worm_optimizer.console.studies import Studies
from worm_optimizer.nodes.operator_node import OperatorError
from worm_optimizer.orders import FrontOrder, ScanOrder, SearchResult

SCAN, FRONT = ScanOrder(1, 0.0, 0.004, 0.001), FrontOrder(1)


class Goal:
    def __init__(self) -> None:
        self.closed = False

    def close(self) -> None:
        self.closed = True


class Node:
    """An operator whose nodes take parameter files, but for those that refuse."""

    def __init__(self) -> None:
        self.goals: list[Goal] = []
        self.ends: list[Callable[[SearchResult], None]] = []
        self.taken: list[tuple[str, str]] = []
        self.refuse = ""

    def search(self, order: object, on_end: Callable[[SearchResult], None]) -> Goal:
        self.goals.append(Goal())
        self.ends.append(on_end)
        return self.goals[-1]

    def take_parameters(self, node: str, file: str) -> None:
        if node == self.refuse:
            raise OperatorError(f"{node} does not take {file}")
        self.taken.append((node, file))


class RobotWorker:
    """Does at once what it is asked for."""

    def __init__(self, node: Node) -> None:
        self.node, self.free = node, True
        self.said: list[str] = []

    def ask(self, doing: str, act: Callable[[Node], str]) -> bool:
        if self.free:
            self.said.append(act(self.node))
        return self.free


class Shelf:
    """Identifies what it is told to."""

    def __init__(self) -> None:
        self.release = asyncio.Event()
        self.failure = ""

    async def identify(
        self, names: Sequence[str], parameters: str, tell: Callable[[str], None]
    ) -> str:
        tell("locomotion: 40%")
        await self.release.wait()
        if self.failure:
            raise InputError(self.failure)
        return "identified_1.yaml"


@pytest.fixture
def bench() -> SimpleNamespace:
    node = Node()
    worker, shelf = RobotWorker(node), Shelf()
    hub = Hub(worker, Control(lambda: 0.0), shelf, PAPER, "", new_words(), {1: ["a gait"]})
    return SimpleNamespace(node=node, worker=worker, shelf=shelf, hub=hub, studies=Studies(hub))


def test_a_scan_goes_on_until_it_ends_and_is_kept(bench: SimpleNamespace):
    assert bench.studies.search(SCAN)
    assert bench.studies.searching == "margin scan"
    assert not bench.studies.search(FRONT)
    found = SearchResult(True, "the cliff is at 3.40 mm", (0.0, 0.001), (50.0, 60.0), 0.0034)
    bench.node.ends[0](found)
    assert bench.studies.searching == ""
    assert bench.studies.scan is found
    assert bench.hub.words[-1].text == "margin scan: the cliff is at 3.40 mm"
    assert bench.hub.fronts
    assert bench.studies.search(FRONT)
    assert bench.node.goals[0].closed


def test_a_new_front_makes_what_was_read_worthless(bench: SimpleNamespace):
    assert bench.studies.search(FRONT)
    bench.node.ends[0](SearchResult(True, "margin 2.50 mm"))
    assert bench.hub.fronts == {}


def test_a_failed_search_changes_nothing_and_is_no_good_word(bench: SimpleNamespace):
    bench.studies.search(FRONT)
    bench.node.ends[0](SearchResult(False, "margin: -1.0 m"))
    assert bench.hub.fronts
    assert not bench.hub.words[-1].good


def test_a_worker_that_is_not_free_begins_nothing(bench: SimpleNamespace):
    bench.worker.free = False
    assert not bench.studies.search(SCAN)
    assert bench.studies.searching == ""


def test_an_identification_tells_how_far_it_is_and_what_it_wrote(bench: SimpleNamespace):
    async def identify() -> None:
        assert bench.studies.identify(["run"])
        assert not bench.studies.identify(["run"])
        await asyncio.sleep(0)
        assert bench.studies.identifying == "identification, locomotion: 40%"
        bench.shelf.release.set()
        await bench.studies._task

    asyncio.run(identify())
    assert bench.studies.identifying == ""
    assert bench.studies.identified == "identified_1.yaml"
    assert "identified_1.yaml is written" in bench.hub.words[-1].text


@pytest.mark.parametrize(("failure", "says"), [("no run", "no run"), ("", "cancelled")])
def test_one_that_comes_to_nothing_says_why(bench: SimpleNamespace, failure: str, says: str):
    async def identify() -> None:
        bench.studies.identify(["run"])
        await asyncio.sleep(0)
        bench.shelf.failure = failure
        if failure:
            bench.shelf.release.set()
        else:
            bench.studies.cancel_identification()
        await bench.studies._task

    asyncio.run(identify())
    assert bench.studies.identifying == bench.studies.identified == ""
    assert bench.hub.words[-1].text == f"identification: {says}"


def test_both_nodes_take_the_parameters_over_and_the_pages_too(
    bench: SimpleNamespace, tmp_path: Path
):
    file = tmp_path / "robot.yaml"
    write_parameter_file(file, ParameterFile(PAPER))
    assert bench.studies.take_over(str(file))
    assert bench.node.taken == [("twin", str(file)), ("optimizer", str(file))]
    assert (bench.hub.parameter_file, bench.hub.fronts) == (str(file), {})
    assert bench.studies.started == ""
    assert bench.studies.take_over("")
    assert bench.worker.said[-1] == "twin and optimizer have taken the paper’s values over"


def test_where_one_refuses_nothing_else_is_said_to_be_so(bench: SimpleNamespace, tmp_path: Path):
    file = tmp_path / "robot.yaml"
    with pytest.raises(ParameterError):
        bench.studies.take_over(str(file))
    write_parameter_file(file, ParameterFile(PAPER))
    bench.node.refuse = "optimizer"
    with pytest.raises(OperatorError, match="only the twin has taken it: optimizer does not"):
        bench.studies.take_over(str(file))
    assert bench.hub.parameter_file == ""
