# SPDX-License-Identifier: Apache-2.0
"""Spreads work over Dask workers: the cores of this machine, or a cluster that is there already.

The client hands out pieces and takes back what they made, a few for each worker at a time, so that its memory
holds pieces and not the study. Only workers with this code get any: each is asked before, and those of
another version are named and left alone. What a lost worker had is handed to another.
"""

from __future__ import annotations

import contextlib
import itertools
import logging
import os
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import CancelledError
from dataclasses import dataclass, field
from typing import Any

from distributed import Client, Future, KilledWorker, LocalCluster, wait

from worm_optimizer.study.version import identity

_AHEAD = 2  # pieces for each worker that are handed out: one in work, one waiting
_LOOK = 1.0  # s between two looks at who is there
_CONNECT = 10.0  # s

Say = Callable[[str], None]


class ClusterError(ValueError):
    """The cluster cannot be used; the message says why and what to do."""


class LostError(RuntimeError):
    """The cluster was lost on the way; the message says what is known of it."""


@contextlib.contextmanager
def connected(scheduler: str, workers: int) -> Iterator[Client]:
    """A client of the cluster at an address; of one on this machine, with so many workers, if that is empty.

    Raises `ClusterError` if nobody answers at the address.
    """
    for name in ("distributed", "bokeh"):  # what matters is said here, in words
        logging.getLogger(name).setLevel(logging.CRITICAL)
    if not scheduler:
        with (
            LocalCluster(
                n_workers=workers,
                threads_per_worker=1,
                processes=True,
                dashboard_address=None,
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
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0))


@dataclass
class _Crew:
    """Who may work: each worker is asked once which code it has."""

    client: Client
    say: Say
    mine: str = field(default_factory=identity)
    able: set[str] = field(default_factory=set)
    refused: dict[str, str] = field(default_factory=dict)

    def look(self) -> None:
        """Brings the lists up to date."""
        present = set(self.client.scheduler_info(n_workers=-1)["workers"])
        self.able &= present
        new = present - self.able - set(self.refused)
        if not new:
            return
        answers = self.client.run(identity, workers=sorted(new), on_error="return")
        for address, answer in sorted(answers.items()):
            if answer == self.mine:
                self.able.add(address)
            elif isinstance(answer, str | ImportError | AttributeError):
                self.refused[address] = _refusal(answer, self.mine)
                self.say(f"worker {address} is refused: {self.refused[address]}")


def _refusal(answer: str | BaseException, mine: str) -> str:
    if isinstance(answer, BaseException):
        return f"it cannot import worm_optimizer.study ({answer}); install worm_model and worm_optimizer there"
    return f"it has another version (code {answer}, here {mine}); install the same there"


@dataclass(frozen=True)
class _Given:
    """A piece that has been handed out, and to whom it may go."""

    place: int
    to: frozenset[str]


def spread(
    client: Client, function: Callable[..., Any], pieces: Iterable[tuple[Any, ...]], say: Say
) -> Iterator[tuple[int, Any]]:
    """(place, result) of ``function(*piece)`` for each piece, as they finish.

    Raises `ClusterError` if every worker is refused, `LostError` if the scheduler is lost or a piece ends every
    worker that it is given to; else what the function raises.
    """
    crew = _Crew(client, say)
    crew.look()
    if crew.refused and not crew.able:
        address, why = next(iter(crew.refused.items()))
        raise ClusterError(f"no worker can be used: worker {address}: {why}")
    numbered = enumerate(pieces)
    kept: dict[int, tuple[Any, ...]] = {}
    out: dict[Future, _Given] = {}
    attempts = itertools.count()
    told = False

    def hand_out(place: int) -> None:
        to = frozenset(crew.able)
        future = client.submit(
            function,
            *kept[place],
            key=f"worm-study-{os.getpid()}-{place}-{next(attempts)}",
            workers=sorted(to),
            pure=False,
        )
        out[future] = _Given(place, to)

    try:
        while True:
            if client.status != "running":
                raise LostError("the connection to the scheduler is lost")
            crew.look()
            if not crew.able and not told:
                say("no worker is there: waiting for one (Ctrl-C ends this; what is finished stays)")
            told = not crew.able
            for future in [f for f, given in out.items() if crew.able and not given.to & crew.able]:
                place = out.pop(future).place
                future.cancel()
                hand_out(place)
            room = _AHEAD * len(crew.able) - len(out)
            for place, piece in itertools.islice(numbered, max(room, 0)):
                kept[place] = piece
                hand_out(place)
            if not kept:
                return
            for future in _finished(list(out)):
                place = out.pop(future).place
                if future.status in ("cancelled", "lost"):
                    hand_out(place)
                    continue
                yield place, _result(future)
                del kept[place]
    finally:
        with contextlib.suppress(Exception):  # the scheduler may be gone
            client.cancel(list(out))


def _finished(futures: list[Future]) -> list[Future]:
    """Those that are over, after a moment at most."""
    if not futures:
        time.sleep(_LOOK)  # nobody is there to work
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
