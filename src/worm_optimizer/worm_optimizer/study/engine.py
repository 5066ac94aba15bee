# SPDX-License-Identifier: Apache-2.0
"""Distribution of work to Dask workers: the cores of this machine, or an existing cluster.

The work is divided into pieces. The client submits a few pieces for each worker at a time and collects their results,
so that its memory never holds the whole study. It first compares the code of each worker with its own. It reports
workers with another version and does not use them. It submits the pieces of a lost worker to another worker.
"""

from __future__ import annotations

import contextlib
import itertools
import logging
import os
import time
import uuid
from asyncio import CancelledError as AsyncioCancelledError
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import CancelledError
from dataclasses import dataclass, field
from typing import Any

from distributed import Client, Future, KilledWorker, LocalCluster, wait
from distributed.client import ClosedClientError
from distributed.comm import CommClosedError

from worm_model.errors import InputError
from worm_optimizer.code_version import identity_of_all

_AHEAD = 2  # pieces submitted per worker: it computes one while the other one waits
_UPDATE = 1.0  # interval between two updates of the list of workers, s
_CONNECT = 10.0  # timeout of the connection to the scheduler, s

# Errors of the client when its scheduler ends during a request.
_LOSSES = (CancelledError, AsyncioCancelledError, CommClosedError, ClosedClientError, TimeoutError)

Say = Callable[[str], None]


class ClusterError(InputError):
    """The cluster cannot be used. The message contains the reason and what to do."""


class LostError(RuntimeError):
    """The cluster was lost during the work. The message contains what is known about the cause."""


@contextlib.contextmanager
def connected(scheduler: str, workers: int, say: Say) -> Iterator[Client]:
    """Connect to a cluster of Dask workers.

    Args:
        scheduler: address of the scheduler. If it is empty, a cluster is started on this machine.
        workers: number of workers to start on this machine.
        say: function that is called with each message.

    Yields:
        The client.

    Raises:
        ClusterError: No scheduler answers at the address, or the workers on this machine do not start.
    """
    for name in ("distributed", "distributed.nanny", "distributed.scheduler", "bokeh"):
        logging.getLogger(name).setLevel(logging.CRITICAL)  # this module reports what matters
    if scheduler:
        say(f"connecting to {scheduler}")
    else:
        say(f"starting {workers} {'worker' if workers == 1 else 'workers'} on this machine")
    with contextlib.ExitStack() as stack:
        if scheduler:
            client = _client_of(scheduler)
        else:
            client = Client(stack.enter_context(_local_cluster(workers)))
        stack.enter_context(client)
        say(f"Dask's dashboard is at {client.dashboard_link}")
        yield client


def _client_of(scheduler: str) -> Client:
    try:
        return Client(scheduler, timeout=_CONNECT)
    except (OSError, ValueError) as error:
        raise ClusterError(
            f"no Dask scheduler answers at {scheduler} ({' '.join(str(error).split())}): "
            "start one with `dask scheduler`, or leave --scheduler out"
        ) from None


def _local_cluster(workers: int) -> LocalCluster:
    try:
        return LocalCluster(
            n_workers=workers,
            threads_per_worker=1,
            processes=True,
            dashboard_address="127.0.0.1:0",
            memory_limit=0,
        )
    except (OSError, RuntimeError) as error:
        cause: BaseException = error
        while cause.__cause__ is not None:
            cause = cause.__cause__
        raise ClusterError(
            f"the workers on this machine do not start ({type(cause).__name__}: {' '.join(str(cause).split())}): "
            "use fewer with --workers, or free memory and processes"
        ) from None


def cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0))


@dataclass
class _WorkerPool:
    """Addresses of the workers of a cluster. `update` requests the code version of each worker until it answers."""

    client: Client
    say: Say
    mine: str = field(default_factory=identity_of_all)
    accepted: set[str] = field(default_factory=set)
    rejected: dict[str, str] = field(default_factory=dict)  # reason of the rejection, by address
    unanswered: set[str] = field(default_factory=set)

    def update(self) -> None:
        """Remove lost workers, and request the code version of each worker that has not answered yet."""
        present = set(self.client.scheduler_info(n_workers=-1)["workers"])
        self.accepted &= present
        self.rejected = {each: why for each, why in self.rejected.items() if each in present}
        new = present - self.accepted - set(self.rejected)
        self.unanswered &= new
        if not new:
            return
        answers = self.client.run(identity_of_all, workers=sorted(new), on_error="return")
        for address, answer in sorted(answers.items()):
            if answer == self.mine:
                self.accepted.add(address)
            elif isinstance(answer, OSError):  # the connection failed
                self.unanswered.add(address)
            else:
                self.rejected[address] = _reason(answer, self.mine)
                self.say(f"worker {address} is rejected: {self.rejected[address]}")
        self.unanswered -= self.accepted | set(self.rejected)


def _reason(answer: str | BaseException, mine: str) -> str:
    if isinstance(answer, BaseException):
        return (
            f"it cannot import worm_optimizer.study ({answer}); "
            "install worm_msgs, worm_model and worm_optimizer there"
        )
    return f"it has another version (code {answer}, here {mine}); install the version of this machine there"


@dataclass
class _Dispatcher:
    """Submission of pieces to the workers. The arguments of a piece are stored until its result is available.

    Attributes:
        client: client of the cluster.
        pool: workers.
        function: function that a worker calls with a piece.
        pieces: (index, arguments) of the pieces that are still to be submitted.
        stored: arguments of the submitted pieces, by index.
        out: (index of the piece, workers that may compute it), by the future of the submission.
        attempts: number of submissions so far, of all pieces.
        name: prefix of the keys under which the scheduler knows the submissions.
    """

    client: Client
    pool: _WorkerPool
    function: Callable[..., Any]
    pieces: Iterator[tuple[int, tuple[Any, ...]]]
    stored: dict[int, tuple[Any, ...]] = field(default_factory=dict)
    out: dict[Future, tuple[int, frozenset[str]]] = field(default_factory=dict)
    attempts: int = 0
    # Unique prefix of the keys, because the scheduler may still know keys of an earlier run.
    name: str = field(default_factory=lambda: uuid.uuid4().hex)

    def fill(self) -> None:
        """Submit pieces up to the capacity of the workers, first the pieces whose workers are all lost."""
        accepted = self.pool.accepted
        if not accepted:
            return
        for future in [future for future, (_, to) in self.out.items() if not to & accepted]:
            future.cancel()
            self.submit(self.out.pop(future)[0])
        room = max(_AHEAD * len(accepted) - len(self.out), 0)
        for place, piece in itertools.islice(self.pieces, room):
            self.stored[place] = piece
            self.submit(place)

    def submit(self, place: int) -> None:
        """Submit a piece, possibly again."""
        self.attempts += 1
        accepted = sorted(self.pool.accepted)
        key = f"worm-study-{self.name}-{place}-{self.attempts}"
        future = self.client.submit(
            self.function, *self.stored[place], key=key, workers=accepted, pure=False
        )
        self.out[future] = (place, frozenset(accepted))

    def results(self) -> Iterator[tuple[int, Any]]:
        """Yield index and result of the finished pieces, and submit lost pieces again."""
        for future in _finished(list(self.out)):
            place, _ = self.out.pop(future)
            if future.status in ("cancelled", "lost"):
                _check_connection(self.client)
                self.submit(place)
                continue
            yield place, _result(future)
            del self.stored[place]

    def clear(self) -> None:
        """Cancel all submitted pieces."""
        with contextlib.suppress(Exception):  # the scheduler may be gone
            self.client.cancel(list(self.out))


def spread(
    client: Client, function: Callable[..., Any], pieces: Iterable[tuple[Any, ...]], say: Say
) -> Iterator[tuple[int, Any]]:
    """Yield (index of the piece, ``function(*piece)``) for each piece, in the order in which they finish.

    An exception that the function raises in a worker is raised here.

    Raises:
        ClusterError: A worker was rejected, and no worker is accepted.
        LostError: The connection to the scheduler is lost, or several workers died while computing the same piece.
    """
    pool = _WorkerPool(client, say)
    dispatcher = _Dispatcher(client, pool, function, enumerate(pieces))
    waiting_reported = False
    try:
        while True:
            _check_connection(client)
            pool.update()
            if pool.rejected and not pool.accepted:
                address, why = next(iter(pool.rejected.items()))
                raise ClusterError(f"no worker can be used: worker {address}: {why}")
            if not pool.accepted and not waiting_reported:
                number = len(pool.unanswered)
                state = f"{number} have not answered yet" if number else "none is connected"
                say(
                    f"waiting for workers, {state} (Ctrl-C ends this command; finished results remain)"
                )
            waiting_reported = not pool.accepted
            dispatcher.fill()
            if pool.accepted and not dispatcher.stored:
                return
            yield from dispatcher.results()
    except _LOSSES as error:
        raise LostError(
            f"the connection to the scheduler is lost ({type(error).__name__})"
        ) from None
    finally:
        dispatcher.clear()


def _check_connection(client: Client) -> None:
    if client.status != "running":
        raise LostError("the connection to the scheduler is lost")


def _finished(futures: list[Future]) -> list[Future]:
    """Return the finished futures, after waiting for at most `_UPDATE` seconds."""
    if not futures:
        time.sleep(_UPDATE)  # No piece is submitted, because no worker is accepted.
    with contextlib.suppress(TimeoutError, CancelledError):
        wait(futures, timeout=_UPDATE, return_when="FIRST_COMPLETED")
    return [future for future in futures if future.done()]


def _result(future: Future) -> Any:
    try:
        return future.result()
    except KilledWorker as error:
        raise LostError(
            f"all workers that computed the piece {error.task} have died: "
            "read the workers' logs; out of memory is the usual cause"
        ) from None
