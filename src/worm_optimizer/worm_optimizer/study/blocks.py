# SPDX-License-Identifier: Apache-2.0
"""Blocks of results: computed by Dask workers, and each stored as a file by the client.

The name of a file is the hash of all that determines its content. A file begins with the hash of the rest, and gets its
name when it is complete. A block whose file is missing or damaged is computed again. Dask submits the blocks of a lost
worker to another worker.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import logging
import os
from asyncio import CancelledError as AsyncioCancelledError
from collections.abc import Callable, Iterator, Mapping, Sequence
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
Compute = Callable[[np.ndarray], Block]
Say = Callable[[str], None]

_DIGEST = hashlib.sha256().digest_size  # bytes
_CONNECT = 10.0  # timeout of the connection to the scheduler, s
# Errors of the client when several workers die while they compute a block, or when the scheduler ends
_LOSSES = (
    *(KilledWorker, CancelledError, AsyncioCancelledError, CommClosedError, ClosedClientError),
    TimeoutError,
)


class LostError(RuntimeError):
    """The cluster was lost during the work. The message contains what is known about the cause."""


@dataclass(frozen=True)
class Workers:
    """Workers to use.

    Attributes:
        scheduler: address of a cluster's scheduler. If it is empty, workers are started on this machine.
        number: number of workers on this machine; None starts one per core.
    """

    scheduler: str = ""
    number: int | None = None


def complete(
    compute: Compute,
    pieces: Sequence[np.ndarray],
    identity: str,
    folder: Path,
    workers: Workers,
    say: Say,
    progress: Callable[[float], None],
) -> list[Block]:
    """Return a block for each piece. Blocks without an intact file are computed and stored.

    If this fails, the blocks that were computed remain.

    Args:
        compute: function that a worker calls with a piece. It returns the results.
        pieces: arrays of points.
        identity: hash of all that determines the results of a point, the code included.
        folder: folder of the blocks, which is created if necessary.
        workers: workers to use.
        say: function that is called with each message.
        progress: function that is called with the finished share of the pieces, 0 to 1.
    """
    folder.mkdir(exist_ok=True)
    files = [folder / f"{_name(identity, piece)}.block" for piece in pieces]
    if unused := len({*folder.glob("*.block")}.difference(files)):
        say(f"{folder}: blocks of another computation or version: {unused}; they are not used")
    found = {file: block for file in files if (block := _stored(file, say)) is not None}
    missing = {file: piece for file, piece in zip(files, pieces, strict=True) if file not in found}
    progress(len(found) / len(files))
    try:
        for file, block in _computed(compute, missing, workers, say) if missing else ():
            _store(file, block)
            found[file] = block
            progress(len(found) / len(files))
    except (LostError, OSError) as error:
        raise LostError(
            f"{error}; {len(found)} of {len(files)} blocks are finished, in {folder}: repeat the command to continue"
        ) from None
    return [found[file] for file in files]


def _name(identity: str, piece: np.ndarray) -> str:
    return hashlib.sha256(identity.encode() + piece.tobytes()).hexdigest()[:32]


def _stored(file: Path, say: Say) -> Block | None:
    """Return the block in a file, or None if the file is missing or damaged."""
    if not file.exists():
        return None
    content = file.read_bytes()
    digest, arrays = content[:_DIGEST], content[_DIGEST:]
    if digest != hashlib.sha256(arrays).digest():
        say(f"{file}: is damaged; what it contained is computed again")
        return None
    with np.load(io.BytesIO(arrays)) as block:
        return dict(block)


def _store(file: Path, block: Block) -> None:
    buffer = io.BytesIO()
    np.savez(buffer, allow_pickle=False, **block)
    arrays = buffer.getvalue()
    write_whole(file, hashlib.sha256(arrays).digest() + arrays)


def write_whole(file: Path, content: bytes) -> None:
    """Write a file, which gets its name when it is complete."""
    part = file.with_name(f".{file.name}.{os.getpid()}.part")
    try:
        part.write_bytes(content)
        part.rename(file)
    finally:
        part.unlink(missing_ok=True)


def _computed(
    compute: Compute, pieces: Mapping[Path, np.ndarray], workers: Workers, say: Say
) -> Iterator[tuple[Path, Block]]:
    """Yield the key and the result of each piece, in the order in which the workers finish.

    An exception that ``compute`` raises in a worker is raised here.
    """
    version = code_identity()
    with _client(workers, len(pieces), say) as client:
        try:
            answers = client.run(code_identity, on_error="return")
            for address, answer in sorted(answers.items()):
                _check(address, answer, version)
            futures = {
                client.submit(_block, version, compute, piece, pure=False): file
                for file, piece in pieces.items()
            }
            for future in as_completed(futures, loop=client.loop):
                yield futures[future], future.result()
                future.release()  # The worker may forget the result.
        except _LOSSES as error:
            raise LostError(
                f"the scheduler, or all workers that computed a block, are lost ({type(error).__name__}): "
                "read their logs; out of memory is the usual cause"
            ) from None


def _block(version: str, compute: Compute, piece: np.ndarray) -> Block:
    """Return a block, in a worker, which may have joined after the client had checked all workers."""
    _check(get_worker().address, code_identity(), version)
    return compute(piece)


def _check(address: str, answer: str | BaseException, version: str) -> None:
    """Raise `InputError` unless a worker's ``answer``, which may be an import error, is the version of the client."""
    if answer != version:
        raise InputError(
            f"worker {address} has another version (code {answer}, here {version}); "
            "install worm_msgs, worm_model and worm_optimizer of this machine there"
        )


@contextlib.contextmanager
def _client(workers: Workers, pieces: int, say: Say) -> Iterator[Client]:
    """Connect to a cluster of Dask workers, or start one on this machine, with at most a worker for each piece."""
    for name in ("distributed", "distributed.nanny", "distributed.scheduler"):
        logging.getLogger(name).setLevel(logging.CRITICAL)  # this module reports what matters
    number = min(workers.number or len(os.sched_getaffinity(0)), pieces)
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
