# SPDX-License-Identifier: Apache-2.0
"""The worker does one thing after the other, stops whatever it waits for, and tells what fails; nodes are made up."""

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest

from worm_optimizer.console.robot_worker import Notice, RobotWorker
from worm_optimizer.nodes.operator_node import OperatorError
from worm_optimizer.operation.bring_up import Check, Say

TIMEOUT_S = 10.0


class Node:
    """An operator whose waiting is short; ``meanwhile`` is done in it."""

    def __init__(self) -> None:
        self.stops = threading.Semaphore(0)
        self.meanwhile: Callable[[], None] = lambda: None
        self.broken = ""
        self.has_lost_driver = False

    def create_subscription(self, *_: object) -> None:
        pass

    def prepare_stop(self) -> None:
        if self.broken:
            raise OperatorError(self.broken)

    def wait(self, condition: Callable[[], bool], timeout_s: float) -> bool:
        self.meanwhile()
        threading.Event().wait(0.001)
        return condition()

    def stop(self) -> str:
        self.stops.release()
        return "holding"


class Bench:
    """A worker with a made-up robot, and what it said."""

    def __init__(self, failure: str = "") -> None:
        self.node, self.stopper, self.failure = Node(), Node(), failure
        self.ends = 0
        self.words: list[Notice] = []
        self.told = threading.Semaphore(0)
        self.worker = RobotWorker(self._robot, self._brake, self._tell)

    def _tell(self, word: Notice) -> None:
        self.words.append(word)
        self.told.release()

    @contextmanager
    def _robot(self, say: Say, check: Check) -> Iterator[Node]:
        try:
            if self.failure:
                raise OperatorError(self.failure)
            self.say = say
            self.node.meanwhile = check
            say("ready")
            yield self.node
        finally:
            self.ends += 1

    @contextmanager
    def _brake(self, check: Check) -> Iterator[Node]:
        self.stopper.meanwhile = check
        yield self.stopper

    def close(self) -> None:
        self.worker.close(impatient=lambda: False)

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
    bench.close()


def test_what_is_asked_for_is_done_and_told(bench: Bench):
    bench.ask(lambda node: "done")
    assert bench.heard("done").good


def test_a_driver_that_is_lost_is_told_once(bench: Bench):
    bench.stopper.has_lost_driver = True
    assert not bench.heard("the driver ended; torque may be on").good
    bench.ask(lambda node: "done")
    bench.heard("done")
    assert sum("torque may be on" in word.text for word in bench.words) == 1
    bench.stopper.has_lost_driver = False


def test_a_failure_is_told_and_the_worker_goes_on(bench: Bench):
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
    assert bench.stopper.stops.acquire(timeout=TIMEOUT_S)  # while the other still waits
    release.set()
    bench.heard("stopped")
    bench.ask(lambda node: "stopped still" if bench.worker.stopped else "free again")
    bench.heard("free again")


def test_a_robot_that_does_not_come_up_is_told(request):
    bench = Bench(failure="twin has ended")
    bench.worker.start()
    request.addfinalizer(bench.close)
    assert not bench.heard("twin has ended").good
    assert bench.worker.hindrance == "twin has ended"
    assert not bench.worker.ask("working", lambda node: "")


def test_a_node_that_starts_again_while_nothing_is_done_hinders_nothing(bench: Bench):
    bench.ask(lambda node: "at rest")
    bench.heard("at rest")

    def restart() -> None:
        bench.node.meanwhile = lambda: None
        bench.say("optimizer has ended: out of memory; it starts again")

    bench.node.meanwhile = restart
    bench.heard("optimizer has ended: out of memory; it starts again")
    bench.ask(lambda node: "done")
    bench.heard("done")


@pytest.mark.parametrize(
    "error", [OSError(28, "No space left on device"), OperatorError("no answer")]
)
def test_what_can_go_wrong_hinders_nothing_else(bench: Bench, error: Exception):
    def fail(node: object) -> str:
        raise error

    bench.ask(fail)
    assert not bench.heard(str(error)).good
    bench.ask(lambda node: "done")
    bench.heard("done")


def test_what_nobody_thought_of_is_told_and_is_the_reason_from_then_on(bench: Bench, capsys):
    def fail(node: object) -> str:
        return {}["a fault of the console"]  # type: ignore[index]

    bench.ask(fail)
    words = "start the console anew, it has failed: KeyError('a fault of the console')"
    assert not bench.heard(words).good
    assert bench.worker.hindrance == words
    assert not bench.worker.ask("more", lambda node: "more")
    assert "Traceback" in capsys.readouterr().err
    bench.worker.stop()
    assert bench.stopper.stops.acquire(timeout=TIMEOUT_S)  # all the same


def test_nothing_is_begun_that_could_not_be_stopped(request):
    bench = Bench()
    bench.stopper.broken = "no service stop"
    bench.worker.start()
    request.addfinalizer(bench.close)
    words = "STOP does not work, so nothing is begun: no service stop"
    assert not bench.heard(words).good
    assert bench.worker.hindrance == words


def test_the_end_waits_for_what_runs_and_gives_up_what_need_not_be():
    bench = Bench()
    bench.worker.start()
    begun = threading.Event()

    def run(node: object) -> str:
        begun.set()
        while not bench.worker.stopped:
            threading.Event().wait(0.001)
        return f"at rest: {bench.worker.stopped}"

    bench.ask(run)
    assert begun.wait(TIMEOUT_S)
    bench.close()
    assert bench.heard("at rest: the console ends").good
    assert bench.ends == 1


def test_who_is_impatient_holds_the_robot():
    bench = Bench()
    bench.worker.start()
    begun = threading.Event()

    def run(node: object) -> str:
        begun.set()
        assert bench.stopper.stops.acquire(timeout=TIMEOUT_S)
        return "held"

    bench.ask(run)
    assert begun.wait(TIMEOUT_S)
    bench.worker.close(impatient=lambda: True)
    assert bench.heard("held").good


def test_what_may_be_given_up_is_where_the_console_ends():
    bench = Bench()
    bench.worker.start()
    begun = threading.Event()

    def read(node: object) -> str:
        begun.set()
        while True:
            bench.worker.going("reading")

    bench.ask(read)
    assert begun.wait(TIMEOUT_S)
    bench.close()
    assert bench.ends == 1
    assert bench.worker.failure == ""


def test_a_start_is_given_up():
    bench = Bench()
    at = threading.Event()

    @contextmanager
    def robot(say: Say, check: Check) -> Iterator[Node]:
        at.set()
        while True:
            check()
        yield bench.node

    bench.worker = RobotWorker(robot, bench._brake, bench._tell)
    bench.worker.start()
    assert at.wait(TIMEOUT_S)
    bench.close()
    assert bench.worker.failure == ""


def test_one_that_was_not_begun_ends():
    Bench().close()
