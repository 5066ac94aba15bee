# SPDX-License-Identifier: Apache-2.0
"""Distribution of work to Dask workers: the cores of this machine, or an existing cluster.

The client submits a few pieces for each worker at a time and collects their results. Its memory therefore holds these
pieces and not the whole study. A worker receives pieces only if its code is identical to the client's, which the
client checks first. Workers with another version are reported and not used. The pieces of a lost worker are submitted
to another one.
"""

from __future__ import annotations

import contextlib
import itertools
import logging
import os
import time
import uuid
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import CancelledError
from dataclasses import dataclass, field
from typing import Any

from distributed import Client, Future, KilledWorker, LocalCluster, wait

from worm_model.errors import InputError
from worm_optimizer.study.version import identity

_AHEAD = 2  # pieces submitted for each worker: one in work, one waiting
_LOOK = 1.0  # interval between two updates of the workers, s
_CONNECT = 10.0  # timeout of the connection, s

Say = Callable[[str], None]


class ClusterError(InputError):
    """The cluster cannot be used. The message contains the reason and what to do."""


class LostError(RuntimeError):
    """The cluster was lost during the work. The message contains what is known about the cause."""


@contextlib.contextmanager
def connected(scheduler: str, workers: int) -> Iterator[Client]:
    """Connect to the cluster at ``scheduler``, or to a new one on this machine with ``workers`` workers if it is empty.

    Yields:
        The client.

    Raises:
        ClusterError: No scheduler answers at the address.
    """
    for name in ("distributed", "bokeh"):  # this module reports what matters
        logging.getLogger(name).setLevel(logging.CRITICAL)
    if not scheduler:
        with (
            LocalCluster(
                n_workers=workers,
                threads_per_worker=1,
                processes=True,
                dashboard_address="127.0.0.1:0",
                memory_limit=0,
            ) as cluster,
            Client(cluster) as client,
        ):
            yield client
        return
    try:
        client = Client(scheduler, timeout=_CONNECT)
    except (OSError, ValueError) as error:
        raise ClusterError(
            f"no Dask scheduler answers at {scheduler} ({' '.join(str(error).split())}): "
            "start one with `dask scheduler`, or leave --scheduler out"
        ) from None
    with client:
        yield client


def cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0))


@dataclass
class _Crew:
    """Workers of the cluster. The code version of each worker is requested once."""

    client: Client
    say: Say
    mine: str = field(default_factory=identity)
    able: set[str] = field(default_factory=set)
    refused: dict[str, str] = field(default_factory=dict)
    silent: set[str] = field(default_factory=set)  # workers without an answer yet

    def look(self) -> None:
        """Update the lists of workers."""
        present = set(self.client.scheduler_info(n_workers=-1)["workers"])
        self.able &= present
        self.refused = {each: why for each, why in self.refused.items() if each in present}
        new = present - self.able - set(self.refused)
        self.silent &= new
        if not new:
            return
        answers = self.client.run(identity, workers=sorted(new), on_error="return")
        for address, answer in sorted(answers.items()):
            if answer == self.mine:
                self.able.add(address)
            elif isinstance(answer, str | ImportError | AttributeError):
                self.refused[address] = _refusal(answer, self.mine)
                self.say(f"worker {address} is refused: {self.refused[address]}")
            else:
                self.silent.add(address)
        self.silent -= self.able | set(self.refused)


def _refusal(answer: str | BaseException, mine: str) -> str:
    if isinstance(answer, BaseException):
        return f"it cannot import worm_optimizer.study ({answer}); install worm_model and worm_optimizer there"
    return f"it has another version (code {answer}, here {mine}); install the same there"


@dataclass
class _Dispatcher:
    """Pieces in work, with the workers that may compute them. A piece is stored until its result is available."""

    client: Client
    crew: _Crew
    function: Callable[..., Any]
    pieces: Iterator[tuple[int, tuple[Any, ...]]]
    kept: dict[int, tuple[Any, ...]] = field(default_factory=dict)
    out: dict[Future, tuple[int, frozenset[str]]] = field(default_factory=dict)
    attempts: int = 0
    # Unique prefix of the keys, because the scheduler may still know keys of an earlier run.
    name: str = field(default_factory=lambda: uuid.uuid4().hex)

    def fill(self) -> None:
        """Submit pieces up to the capacity of the workers, orphaned pieces first."""
        able = self.crew.able
        if not able:
            return
        for future in [future for future, (_, to) in self.out.items() if not to & able]:
            future.cancel()
            self.hand_out(self.out.pop(future)[0])
        room = max(_AHEAD * len(able) - len(self.out), 0)
        for place, piece in itertools.islice(self.pieces, room):
            self.kept[place] = piece
            self.hand_out(place)

    def hand_out(self, place: int) -> None:
        """Submit a piece, possibly again."""
        self.attempts += 1
        able = sorted(self.crew.able)
        key = f"worm-study-{self.name}-{place}-{self.attempts}"
        future = self.client.submit(
            self.function, *self.kept[place], key=key, workers=able, pure=False
        )
        self.out[future] = (place, frozenset(able))

    def results(self) -> Iterator[tuple[int, Any]]:
        """Yield place and result of the finished pieces, and submit lost pieces again."""
        for future in _finished(list(self.out)):
            place, _ = self.out.pop(future)
            if future.status in ("cancelled", "lost"):
                self.hand_out(place)
                continue
            yield place, _result(future)
            del self.kept[place]

    def clear(self) -> None:
        """Cancel all pieces in work."""
        with contextlib.suppress(Exception):  # the scheduler may be gone
            self.client.cancel(list(self.out))


def spread(
    client: Client, function: Callable[..., Any], pieces: Iterable[tuple[Any, ...]], say: Say
) -> Iterator[tuple[int, Any]]:
    """Yield (place, result) of ``function(*piece)`` for each piece, in the order in which they finish.

    Exceptions of the function are raised here, too.

    Raises:
        ClusterError: Every worker was rejected.
        LostError: The scheduler is lost, or a piece ended every worker that computed it.
    """
    crew = _Crew(client, say)
    dispatcher = _Dispatcher(client, crew, function, enumerate(pieces))
    idle_said = False
    try:
        while True:
            if client.status != "running":
                raise LostError("the connection to the scheduler is lost")
            crew.look()
            if crew.refused and not crew.able:
                address, why = next(iter(crew.refused.items()))
                raise ClusterError(f"no worker can be used: worker {address}: {why}")
            if not crew.able and not idle_said:
                there = (
                    f"{len(crew.silent)} have not answered yet" if crew.silent else "none is there"
                )
                say(f"waiting for workers, {there} (Ctrl-C ends this; what is finished stays)")
            idle_said = not crew.able
            dispatcher.fill()
            if crew.able and not dispatcher.kept:
                return
            yield from dispatcher.results()
    finally:
        dispatcher.clear()


def _finished(futures: list[Future]) -> list[Future]:
    """Return the finished futures, after waiting for at most `_LOOK` seconds."""
    if not futures:
        time.sleep(_LOOK)  # No worker is connected.
    with contextlib.suppress(TimeoutError, CancelledError):
        wait(futures, timeout=_LOOK, return_when="FIRST_COMPLETED")
    return [future for future in futures if future.done()]


def _result(future: Future) -> Any:
    try:
        return future.result()
    except KilledWorker as error:
        raise LostError(
            f"each worker that a piece was given to has died ({error.task}): "
            "look at the workers' logs; out of memory is the usual cause"
        ) from None
