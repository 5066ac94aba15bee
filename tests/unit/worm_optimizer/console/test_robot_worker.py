# SPDX-License-Identifier: Apache-2.0
"""The worker executes one command after the other, stops at any time, and reports failures; nodes are fakes."""

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest
from waiting import TIMEOUT_S, wait_for

from worm_model.run import Activity
from worm_optimizer.console.robot_worker import Notice, RobotWorker
from worm_optimizer.nodes.robot_client import OperatorError
from worm_optimizer.operation.bring_up import Check, Say
from worm_optimizer.robot_commands import DriverState, Snapshot


class Node:
    """Fake operator with short waits; ``meanwhile`` is called in each."""

    def __init__(self) -> None:
        self.stops = threading.Semaphore(0)
        self.meanwhile: Callable[[], None] = lambda: None
        self.broken = ""
        self.has_driver, self.has_lost_driver = True, False
        self.known, self.telemetry = Snapshot(), self

    def subscribe_to_all(self) -> None: ...

    def snapshot(self) -> Snapshot:
        return self.known

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
    """Worker with a fake robot, and its notices."""

    def __init__(self, failure: str = "") -> None:
        self.node, self.stopper, self.failure = Node(), Node(), failure
        self.ends = 0
        self.notices: list[Notice] = []
        self.notified = threading.Semaphore(0)
        self.worker = RobotWorker(self._robot, self._stop, self._notify)

    def _notify(self, notice: Notice) -> None:
        self.notices.append(notice)
        self.notified.release()

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
    def _stop(self, check: Check) -> Iterator[Node]:
        self.stopper.meanwhile = check
        yield self.stopper

    def close(self) -> None:
        self.worker.close(hold_now=lambda: False)

    def notice(self, text: str) -> Notice:
        while not any(notice.text == text for notice in self.notices):
            assert self.notified.acquire(timeout=TIMEOUT_S), f"no {text!r}: {self.notices}"
        return next(notice for notice in self.notices if notice.text == text)

    def submit(self, command: Callable[[object], str]) -> None:
        wait_for(lambda: self.worker.submit("working", command))

    def begin(self, end: Callable[[], object]) -> None:
        """Submit a command, and wait until it has begun. It reports its cancellation after ``end`` returns."""
        begun = threading.Event()

        def work(node: object) -> str:
            begun.set()
            end()
            return f"ended: {self.worker.cancellation}"

        self.submit(work)
        assert begun.wait(TIMEOUT_S)


@pytest.fixture
def bench() -> Iterator[Bench]:
    bench = Bench()
    bench.worker.start()
    yield bench
    bench.close()  # at once if the test has closed it


def test_a_lost_driver_is_reported_once(bench: Bench):
    bench.stopper.has_lost_driver = True
    assert not bench.notice("the driver ended; torque may be on").good
    bench.submit(lambda node: "done")
    bench.notice("done")
    assert sum("torque may be on" in notice.text for notice in bench.notices) == 1
    bench.stopper.has_lost_driver = False


def test_there_is_no_state_of_a_driver_that_has_ended(bench: Bench):
    driver = DriverState(Activity.IDLE, True, False, 0, 0, 0, 0.0, 0.0, 1, "")
    bench.stopper.known = Snapshot(driver=driver, power=2.0)
    wait_for(lambda: bench.worker.snapshot().driver is driver)
    bench.stopper.has_driver = False
    wait_for(lambda: bench.worker.snapshot().driver is None)
    assert bench.worker.snapshot().power == 2.0


def test_a_stop_does_not_wait_for_the_present_command_which_learns_of_it(bench: Bench):
    release = threading.Event()
    bench.begin(lambda: release.wait(TIMEOUT_S))
    assert bench.worker.busy == "working"
    assert bench.worker.hindrance
    bench.worker.stop()
    assert "STOP" in bench.worker.busy
    assert bench.stopper.stops.acquire(timeout=TIMEOUT_S)
    assert bench.notice("holding").good
    wait_for(lambda: not bench.worker.stopping)
    release.set()
    bench.notice("ended: STOP was pressed")
    wait_for(lambda: not bench.worker.busy)
    bench.begin(lambda: None)
    bench.notice("ended: ")  # the next command is not cancelled


def test_one_command_may_wait_for_the_end_of_the_present_one(bench: Bench):
    release = threading.Event()
    bench.begin(lambda: release.wait(TIMEOUT_S))
    assert bench.worker.submit("deactivating", lambda node: bench.worker.busy)
    assert not bench.worker.submit("again", lambda node: "again")
    release.set()
    bench.notice("deactivating")
    wait_for(lambda: not bench.worker.busy)
    assert [notice.text for notice in bench.notices[1:]] == ["ended: ", "deactivating"]


def test_a_command_that_waits_for_the_start_is_executed_and_ends():
    bench = Bench()
    assert bench.worker.submit("deactivating", lambda node: "the torque is off")
    bench.worker.start()
    bench.notice("the torque is off")
    wait_for(lambda: not bench.worker.busy)
    bench.close()


def test_a_quiet_command_gives_way_to_each_other_one_and_the_end_abandons_it(bench: Bench):
    bench.submit(lambda node: "up")
    bench.notice("up")
    begun = threading.Semaphore(0)

    def predict(node: Node) -> str:
        begun.release()
        while True:
            node.wait(lambda: False, TIMEOUT_S)

    bench.worker.submit_quietly(predict)
    for result in ("first", "second"):
        assert begun.acquire(timeout=TIMEOUT_S)  # from its beginning
        assert not bench.worker.hindrance
        bench.submit(lambda node, result=result: result)
        assert bench.notice(result).good
    assert begun.acquire(timeout=TIMEOUT_S)
    bench.close()
    assert bench.ends == 1
    assert bench.worker.failure == ""


def test_a_robot_that_does_not_start_is_reported():
    bench = Bench(failure="twin has ended")
    bench.worker.start()
    assert not bench.notice("twin has ended").good
    assert bench.worker.hindrance == "twin has ended"
    assert not bench.worker.busy  # the pages show the failure, and the end waits for nothing
    assert not bench.worker.submit("working", lambda node: "")
    bench.close()


def test_a_restarted_node_blocks_no_command(bench: Bench):
    bench.submit(lambda node: "at rest")
    bench.notice("at rest")

    def restart() -> None:
        bench.node.meanwhile = lambda: None
        bench.say("optimizer has ended: out of memory; it starts again")

    bench.node.meanwhile = restart
    bench.notice("optimizer has ended: out of memory; it starts again")
    bench.submit(lambda node: "done")
    bench.notice("done")


@pytest.mark.parametrize(
    "error", [OSError(28, "No space left on device"), OperatorError("no answer")]
)
def test_an_error_of_a_command_blocks_no_other_one(bench: Bench, error: Exception):
    def fail(node: object) -> str:
        raise error

    bench.submit(fail)
    assert not bench.notice(str(error)).good
    bench.submit(lambda node: "done")
    assert bench.notice("done").good


def test_an_unexpected_error_is_reported_and_ends_all_commands_but_stop(bench: Bench, capsys):
    def fail(node: object) -> str:
        return {}["a fault of the console"]  # type: ignore[index]

    bench.submit(fail)
    message = "the console has failed, restart it: KeyError('a fault of the console')"
    assert not bench.notice(message).good
    assert bench.worker.hindrance == message
    assert not bench.worker.submit("more", lambda node: "more")
    assert "Traceback" in capsys.readouterr().err
    bench.worker.stop()
    assert bench.stopper.stops.acquire(timeout=TIMEOUT_S)  # nevertheless


def test_no_command_is_executed_if_stop_does_not_work():
    bench = Bench()
    bench.stopper.broken = "no service stop"
    bench.worker.start()
    message = "STOP does not work, so no command is executed: no service stop"
    assert not bench.notice(message).good
    assert bench.worker.hindrance == message
    bench.close()


def test_the_end_waits_for_a_run(bench: Bench):
    bench.begin(lambda: wait_for(lambda: bench.worker.cancellation))
    bench.close()
    assert bench.notice("ended: the console ends").good
    assert bench.ends == 1


def test_an_immediate_end_holds_the_robot(bench: Bench):
    bench.begin(lambda: bench.stopper.stops.acquire(timeout=TIMEOUT_S))
    bench.worker.close(hold_now=lambda: True)
    assert bench.notice("holding").good


def test_the_end_abandons_a_start():
    bench = Bench()
    at = threading.Event()

    @contextmanager
    def robot(say: Say, check: Check) -> Iterator[Node]:
        at.set()
        while True:
            check()
        yield bench.node

    bench.worker = RobotWorker(robot, bench._stop, bench._notify)
    bench.worker.start()
    assert at.wait(TIMEOUT_S)
    bench.close()
    assert bench.worker.failure == ""
