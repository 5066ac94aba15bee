# SPDX-License-Identifier: Apache-2.0
"""The worker does one thing after the other, stops whatever it waits for, and tells what fails; nodes are made up."""

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest

from worm_optimizer.console.robot_worker import Notice, RobotWorker
from worm_optimizer.nodes.operator_node import OperatorError

TIMEOUT_S = 10.0


class Node:
    """An operator whose waiting is short."""

    def __init__(self) -> None:
        self.stops = threading.Semaphore(0)

    def create_subscription(self, *_: object) -> None:
        pass

    def prepare_stop(self) -> None:
        pass

    def wait(self, condition: Callable[[], bool], timeout_s: float) -> bool:
        threading.Event().wait(0.001)
        return condition()

    def stop(self) -> str:
        self.stops.release()
        return "holding"


class Bench:
    """A worker with a made-up robot, and what it said."""

    def __init__(self, failure: str = "") -> None:
        self.node, self.failure = Node(), failure
        self.words: list[Notice] = []
        self.told = threading.Semaphore(0)
        self.worker = RobotWorker(self._robot, self._brake, self._tell)

    def _tell(self, word: Notice) -> None:
        self.words.append(word)
        self.told.release()

    @contextmanager
    def _robot(self, say: Callable[[str], None]) -> Iterator[Node]:
        if self.failure:
            raise OperatorError(self.failure)
        say("ready")
        yield self.node

    @contextmanager
    def _brake(self) -> Iterator[Node]:
        yield self.node

    def heard(self, text: str) -> Notice:
        while not any(word.text == text for word in self.words):
            assert self.told.acquire(timeout=TIMEOUT_S), f"never told {text!r}: {self.words}"
        return next(word for word in self.words if word.text == text)

    def ask(self, act: Callable[[object], str]) -> None:
        for _ in range(5000):
            if self.worker.ask("working", act):
                return
            threading.Event().wait(0.002)
        raise AssertionError(self.worker.busy)


@pytest.fixture
def bench() -> Iterator[Bench]:
    bench = Bench()
    bench.worker.start()
    yield bench
    bench.worker.close()


def test_what_is_asked_for_is_done_and_told(bench: Bench):
    bench.ask(lambda node: "done")
    assert bench.heard("done").good


def test_a_failure_is_told_and_the_desk_goes_on(bench: Bench):
    def fail(node: object) -> str:
        raise OperatorError("no answer")

    bench.ask(fail)
    assert not bench.heard("no answer").good
    bench.ask(lambda node: "done")
    assert bench.heard("done").good


def test_one_thing_at_a_time_and_stop_at_any(bench: Bench):
    begun, release = threading.Event(), threading.Event()

    def work(node: object) -> str:
        begun.set()
        release.wait(TIMEOUT_S)
        return "stopped" if bench.worker.stopped else "not stopped"

    bench.ask(work)
    assert begun.wait(TIMEOUT_S)
    assert not bench.worker.ask("more", lambda node: "more")
    assert bench.worker.hindrance == "wait: working"
    bench.worker.stop()
    assert bench.node.stops.acquire(timeout=TIMEOUT_S)  # while the other still waits
    release.set()
    bench.heard("stopped")
    bench.ask(lambda node: "stopped still" if bench.worker.stopped else "free again")
    bench.heard("free again")


def test_a_robot_that_does_not_come_up_is_told(request):
    bench = Bench(failure="twin has ended")
    bench.worker.start()
    request.addfinalizer(bench.worker.close)
    assert not bench.heard("twin has ended").good
    assert bench.worker.hindrance == "twin has ended"
    assert not bench.worker.ask("working", lambda node: "")
