# SPDX-License-Identifier: Apache-2.0
"""Long work in a process of its own, one job at a time, so that it never delays an answer.

A thread would not do: the interpreter's lock would be held for milliseconds at a time. The process
yields to others (its niceness is raised) and ends with the one that started it.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection
from typing import Protocol

from worm_model.parameters import ParameterFile
from worm_optimizer.search.cache import Cache
from worm_optimizer.search.front import (
    Progress,
    Report,
    RobustFront,
    make_front,
    scanned_price,
)
from worm_optimizer.search.optimizer_errors import OptimizerError
from worm_optimizer.search.price_of_robustness import PriceOfRobustness
from worm_optimizer.search.search_settings import Settings

_NICENESS = 5  # enough to let an answer go first, without starving on a busy computer
_PATIENCE = 2.0  # s that a stopped process is given before it is killed


class Job(Protocol):
    """Work that reports its progress and returns one result; raises `OptimizerError` or OSError."""

    def run(self, report: Report) -> object:
        """Does the work."""


@dataclass(frozen=True)
class FrontJob:
    """Computes a front and stores it in the cache."""

    content: ParameterFile
    settings: Settings
    direction: int
    cache: Cache

    def run(self, report: Report) -> RobustFront:
        """See `front.make_front`."""
        return make_front(self.content, self.settings, self.direction, self.cache, report)


@dataclass(frozen=True)
class ScanJob:
    """Scans the margins, or finds the scan in the cache."""

    content: ParameterFile
    settings: Settings
    direction: int
    cache: Cache

    def run(self, report: Report) -> PriceOfRobustness:
        """See `front.scanned_price`."""
        return scanned_price(self.content, self.settings, self.direction, self.cache, report)


@dataclass(frozen=True)
class Outcome:
    """How a job ended: with a result, or with a failure in words, or cancelled."""

    result: object = None
    failure: str = ""
    cancelled: bool = False


@dataclass(eq=False)
class Ticket:
    """A submitted job and who wants to hear of it."""

    job: Job
    on_progress: Callable[[Progress], None]
    on_end: Callable[[Outcome], None]


def _work(job: Job, connection: Connection) -> None:
    os.nice(_NICENESS)
    try:
        connection.send(Outcome(result=job.run(connection.send)))
    except BrokenPipeError:
        return  # the node is gone, nobody wants the result any more
    except (OptimizerError, OSError) as error:
        connection.send(Outcome(failure=str(error)))


@contextlib.contextmanager
def _interrupts_held() -> Iterator[None]:
    """Holds SIGINT back from what is started within, from its first moment on.

    A Ctrl-C in a terminal reaches the whole group; the node decides when the worker ends.
    """
    resource_tracker.ensure_running()  # it would let interrupts through once it is started
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})


class WorkQueue:
    """Runs jobs one after the other, each in a new process. To be polled; never blocks for long."""

    def __init__(self) -> None:
        self._waiting: deque[Ticket] = deque()
        self._running: tuple[Ticket, multiprocessing.process.BaseProcess, Connection] | None = None

    @property
    def busy(self) -> bool:
        """Whether anything is running or waiting."""
        return self._running is not None or bool(self._waiting)

    def submit(self, ticket: Ticket) -> None:
        """Queues a job; its callbacks are called from `poll` and `cancel`."""
        self._waiting.append(ticket)
        self._start_next()

    def cancel(self, ticket: Ticket) -> None:
        """Ends a job at once, running or waiting; one that has already ended stays as it is."""
        if self._running is not None and self._running[0] is ticket:
            self._stop()
        elif ticket in self._waiting:
            self._waiting.remove(ticket)
        else:
            return
        ticket.on_end(Outcome(cancelled=True))
        self._start_next()

    def poll(self) -> None:
        """Passes on what the running job has reported since the last call."""
        while self._running is not None:
            ticket, process, connection = self._running
            try:
                if not connection.poll():
                    return
                message = connection.recv()
            except (EOFError, OSError):
                process.join(_PATIENCE)
                message = Outcome(
                    failure="the worker process ended unexpectedly "
                    f"(exit code {process.exitcode}); its error output says why"
                )
            if isinstance(message, Progress):
                ticket.on_progress(message)
                continue
            self._stop()
            ticket.on_end(message)
            self._start_next()

    def close(self) -> None:
        """Ends everything without a word to anyone."""
        self._waiting.clear()
        self._stop()

    def _start_next(self) -> None:
        if self._running is not None or not self._waiting:
            return
        ticket = self._waiting.popleft()
        context = multiprocessing.get_context(
            "spawn"
        )  # a fork would copy the node's threads' locks
        receiver, sender = context.Pipe(duplex=False)
        process = context.Process(target=_work, args=(ticket.job, sender), daemon=True)
        with _interrupts_held():
            process.start()
        sender.close()
        self._running = (ticket, process, receiver)

    def _stop(self) -> None:
        if self._running is None:
            return
        _, process, connection = self._running
        self._running = None
        connection.close()
        process.terminate()
        process.join(_PATIENCE)
        if process.is_alive():
            process.kill()
            process.join(_PATIENCE)
