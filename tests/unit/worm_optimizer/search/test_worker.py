# SPDX-License-Identifier: Apache-2.0
"""Long work in a process of its own."""

import multiprocessing
import os
import signal
import time
from collections.abc import Callable

import pytest
from worker_jobs import Dying, Endless, Refusing, Steps

from worm_optimizer.search.front import Progress
from worm_optimizer.search.worker import Outcome, Ticket, WorkQueue

DEADLINE_S = 60.0


class Listener:
    """Remembers what a queue tells of a job."""

    def __init__(self, job) -> None:
        self.told: list[Progress] = []
        self.ends: list[Outcome] = []
        self.ticket = Ticket(job, self.told.append, self.ends.append)


@pytest.fixture
def queue():
    queue = WorkQueue()
    yield queue
    queue.close()


def wait_for(queue: WorkQueue, condition: Callable[[], object]) -> None:
    deadline = time.monotonic() + DEADLINE_S
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.005)
        queue.poll()


def has_ended(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return True
    return False


def test_a_job_runs_in_another_process_and_tells_its_progress(queue):
    listener = Listener(Steps(3))
    queue.submit(listener.ticket)
    assert queue.busy
    wait_for(queue, lambda: listener.ends)
    assert [progress.doing for progress in listener.told] == ["step 0", "step 1", "step 2"]
    assert isinstance(listener.ends[0].result, int)
    assert listener.ends[0].result != os.getpid()
    assert not queue.busy


def test_jobs_run_one_after_the_other(queue):
    order: list[str] = []
    for name in ("first", "second"):
        queue.submit(Ticket(Steps(1), lambda _: None, lambda _, name=name: order.append(name)))
    wait_for(queue, lambda: not queue.busy)
    assert order == ["first", "second"]


def test_a_running_job_is_cancelled_at_once(queue):
    listener, next_one = Listener(Endless()), Listener(Steps(1))
    queue.submit(listener.ticket)
    queue.submit(next_one.ticket)
    wait_for(queue, lambda: listener.told)
    queue.cancel(listener.ticket)
    assert listener.ends == [Outcome(cancelled=True)]
    assert has_ended(int(listener.told[0].doing))
    wait_for(queue, lambda: next_one.ends)
    assert next_one.ends[0].result


def test_a_waiting_job_is_cancelled_without_running(queue):
    running, waiting = Listener(Endless()), Listener(Steps(1))
    queue.submit(running.ticket)
    queue.submit(waiting.ticket)
    queue.cancel(waiting.ticket)
    assert waiting.ends == [Outcome(cancelled=True)]
    assert running.ends == []


def test_cancelling_what_has_ended_changes_nothing(queue):
    listener = Listener(Steps(1))
    queue.submit(listener.ticket)
    wait_for(queue, lambda: listener.ends)
    queue.cancel(listener.ticket)
    assert len(listener.ends) == 1


def test_a_refusal_is_told_in_words(queue):
    listener = Listener(Refusing())
    queue.submit(listener.ticket)
    wait_for(queue, lambda: listener.ends)
    assert listener.ends == [Outcome(failure="nothing moves")]


def test_a_worker_that_dies_is_a_failure_and_the_next_job_runs(queue):
    dying, next_one = Listener(Dying()), Listener(Steps(1))
    queue.submit(dying.ticket)
    queue.submit(next_one.ticket)
    wait_for(queue, lambda: next_one.ends)
    assert "ended unexpectedly (exit code -9)" in dying.ends[0].failure
    assert next_one.ends[0].result


def test_an_interrupt_of_the_whole_group_is_left_to_the_node(queue):
    listener = Listener(Steps(3))
    queue.submit(listener.ticket)
    pid = multiprocessing.active_children()[0].pid
    for _ in range(20):  # also while it is still starting
        os.kill(pid, signal.SIGINT)
        time.sleep(0.005)
    wait_for(queue, lambda: listener.ends)
    assert listener.ends[0].result == pid


def test_closing_ends_the_worker_and_forgets_what_waits():
    queue = WorkQueue()
    listener, waiting = Listener(Endless()), Listener(Steps(1))
    queue.submit(listener.ticket)
    queue.submit(waiting.ticket)
    wait_for(queue, lambda: listener.told)
    queue.close()
    assert has_ended(int(listener.told[0].doing))
    assert not queue.busy
    assert listener.ends == waiting.ends == []
