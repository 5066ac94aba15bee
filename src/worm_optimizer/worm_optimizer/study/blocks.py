# SPDX-License-Identifier: Apache-2.0
"""Blocks of results: computed by Dask workers, and each stored as a file by the client.

The name of a file is the hash of its content, and a file gets its name when it is complete. A file that was lost, cut
or changed is therefore no block, and what it contained is computed again. Dask submits the blocks of a lost worker to
another worker.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import logging
import os
from asyncio import CancelledError as AsyncioCancelledError
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from distributed import Client, KilledWorker, as_completed, get_worker
from distributed.client import ClosedClientError
from distributed.comm import CommClosedError

from worm_model.errors import InputError
from worm_optimizer.code_version import code_identity

Block = dict[str, np.ndarray]
Say = Callable[[str], None]

ITEMS = "items"  # entry of a block that contains its items
_IDENTITY = "identity"  # entry of the file of a block: `Task.identity`
_CONNECT = 10.0  # timeout of the connection to the scheduler, s
# Errors of the client when its scheduler ends
_LOSSES = (CancelledError, AsyncioCancelledError, CommClosedError, ClosedClientError, TimeoutError)


class LostError(RuntimeError):
    """The cluster was lost during the work. The message contains what is known about the cause."""


@dataclass(frozen=True)
class Counts:
    """Numbers of points: all ``points``, finished ones (``done``), and ``failed`` ones of these."""

    points: int
    done: int
    failed: int


@dataclass(frozen=True)
class Workers:
    """Workers to use.

    Attributes:
        scheduler: address of a cluster's scheduler. If it is empty, workers are started on this machine.
        number: number of workers on this machine; None starts one per core.
    """

    scheduler: str = ""
    number: int | None = None

    def count(self) -> int:
        """Return the number of workers to start on this machine."""
        return self.number or len(os.sched_getaffinity(0))


@dataclass(frozen=True)
class Task:
    """Computation of many independent items.

    Attributes:
        function: function that a worker calls with ``common`` and some of the items. It returns their results.
        common: first argument of the function.
        items: items, an array with one row for each.
        most: largest number of items in a block.
        identity: hash of all that determines the result of an item, the code included.
    """

    function: Callable[[Any, np.ndarray], Block]
    common: Any
    items: np.ndarray
    most: int
    identity: str


def keys_of(items: np.ndarray) -> list[tuple[Any, ...]]:
    """Return the items as keys of a dictionary."""
    return [tuple(row) for row in items.tolist()]


def complete(
    task: Task, output: Path, workers: Workers, say: Say, progress: Callable[[float], None]
) -> list[Block]:
    """Return blocks that contain all items: those that are stored, and the others, which are computed and stored.

    The items of a block are its entry `ITEMS`. If this fails, the blocks that were computed remain.

    Args:
        task: computation.
        output: file of the results. The folder of the blocks is next to it, see `_folder_of`.
        workers: workers to use.
        say: function that is called with each message.
        progress: function that is called with the finished share of the items, 0 to 1.

    Raises:
        InputError: The output's folder is missing, the cluster cannot be used, or a worker has another version.
        LostError: The connection to the scheduler is lost, or several workers died while computing the same block.
        OSError: A block cannot be written.
    """
    folder, total = _folder_of(output), len(task.items)
    found = list(_stored(folder, task.identity, say))
    known = {key for block in found for key in keys_of(block[ITEMS])}
    missing = [row for row, key in enumerate(keys_of(task.items)) if key not in known]
    pieces = [task.items[missing[k : k + task.most]] for k in range(0, len(missing), task.most)]
    done = total - len(missing)
    progress(done / total)
    try:
        for block in _computed(task, pieces, workers, say) if pieces else ():
            _store(folder, block, task.identity)
            found.append(block)
            done += len(block[ITEMS])
            progress(done / total)
    except (LostError, OSError) as error:
        raise type(error)(
            f"{error}; {done} of {total} are finished, in {folder}: repeat the command to continue"
        ) from None
    return found


def _folder_of(output: Path) -> Path:
    """Return the folder of the blocks of an output, which is created if necessary."""
    if not output.parent.is_dir():
        raise InputError(f"{output}: the folder {output.parent} does not exist; create it first")
    folder = output.with_name(f"{output.name}.blocks")
    folder.mkdir(exist_ok=True)
    return folder


def _stored(folder: Path, identity: str, say: Say) -> Iterator[Block]:
    """Yield the intact blocks of a computation, and report how many files of the folder are not among them."""
    damaged = foreign = 0
    for file in sorted(folder.glob("*.npz")):
        content = file.read_bytes()
        if file.stem != _hash(content):
            damaged += 1
            continue
        with np.load(io.BytesIO(content)) as arrays:
            block = dict(arrays)
        if block.pop(_IDENTITY) == identity:
            yield block
        else:
            foreign += 1
    if damaged:
        say(f"{folder}: damaged blocks: {damaged}; what they contained is computed again")
    if foreign:
        say(f"{folder}: blocks of another computation or version: {foreign}; they are not used")


def _store(folder: Path, block: Block, identity: str) -> None:
    buffer = io.BytesIO()
    np.savez(buffer, allow_pickle=False, **block, **{_IDENTITY: np.array(identity)})
    with new_output(folder / f"{_hash(buffer.getvalue())}.npz") as part:
        part.write_bytes(buffer.getvalue())


@contextlib.contextmanager
def new_output(file: Path) -> Iterator[Path]:
    """Yield the path of a file to write, which gets the name ``file`` when it is complete."""
    part = file.with_name(f".{file.name}.{os.getpid()}.part")
    try:
        yield part
        part.rename(file)
    finally:
        part.unlink(missing_ok=True)


def _hash(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:32]


def _computed(
    task: Task, pieces: Sequence[np.ndarray], workers: Workers, say: Say
) -> Iterator[Block]:
    """Yield the results of each piece, in the order in which the workers finish.

    An exception that the task's function raises in a worker is raised here.
    """
    version = code_identity()
    with _client(workers, len(pieces), say) as client:
        try:
            answers = client.run(code_identity, on_error="return")
            for address, answer in sorted(answers.items()):
                _check(address, answer, version)
            futures = [
                client.submit(_block, version, task.function, task.common, piece, pure=False)
                for piece in pieces
            ]
            for future in as_completed(futures, loop=client.loop):
                yield future.result()
                future.release()  # The worker may forget the result.
        except KilledWorker:
            raise LostError(
                "all workers that computed a block have died: read the workers' logs; out of memory is the usual cause"
            ) from None
        except _LOSSES as error:
            raise LostError(
                f"the connection to the scheduler is lost ({type(error).__name__})"
            ) from None


def _block(version: str, function: Callable[..., Block], common: Any, items: np.ndarray) -> Block:
    """Return a block, in a worker, which may have joined after the client had checked all workers."""
    _check(get_worker().address, code_identity(), version)
    return {ITEMS: items, **function(common, items)}


def _check(address: str, answer: str | BaseException, version: str) -> None:
    """Raise `InputError` unless the code of a worker has the client's version."""
    if isinstance(answer, BaseException):
        raise InputError(
            f"worker {address} cannot import worm_optimizer.study ({answer}); "
            "install worm_msgs, worm_model and worm_optimizer there"
        )
    if answer != version:
        raise InputError(
            f"worker {address} has another version (code {answer}, here {version}); "
            "install the version of this machine there"
        )


@contextlib.contextmanager
def _client(workers: Workers, pieces: int, say: Say) -> Iterator[Client]:
    """Connect to a cluster of Dask workers, or start one on this machine, with at most a worker for each piece."""
    for name in ("distributed", "distributed.nanny", "distributed.scheduler"):
        logging.getLogger(name).setLevel(logging.CRITICAL)  # this module reports what matters
    number = min(workers.count(), pieces)
    options: dict[str, Any]
    if workers.scheduler:
        options = {"address": workers.scheduler, "timeout": _CONNECT}
        advice = "start `dask scheduler` at this address, or leave --scheduler out"
    else:
        options = {"n_workers": number, "threads_per_worker": 1, "memory_limit": 0}
        options |= {"processes": True, "dashboard_address": "127.0.0.1:0"}
        advice = "use fewer workers with --workers, or free memory and processes"
    say(f"connecting to {workers.scheduler or f'{number} workers, started on this machine'}")
    try:
        # A default client would set the scheduler of xarray, too, which may outlive it.
        client = Client(set_as_default=False, **options)
    except (OSError, ValueError, RuntimeError) as error:
        cause: BaseException = error
        while cause.__cause__ is not None:
            cause = cause.__cause__
        raise InputError(
            f"no Dask scheduler or workers ({type(cause).__name__}: {' '.join(str(cause).split())}): {advice}"
        ) from None
    try:
        yield client
    finally:
        # Dask asserts that it has started a worker, which it may just be replacing after a death.
        with contextlib.suppress(AssertionError):
            client.close()
