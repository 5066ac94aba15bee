# SPDX-License-Identifier: Apache-2.0
"""Run of a study: computation and storage of its unfinished and damaged points, block by block."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from distributed import Client

from worm_optimizer.study.engine import LostError, Say, connected, cores, spread
from worm_optimizer.study.plan import Study
from worm_optimizer.study.point import compute_block
from worm_optimizer.study.store import (
    Audit,
    Region,
    Store,
    block_shape,
    existing_store,
    locked_store,
    regions,
)

_TIMED_POINTS = 3  # number of points whose computation `estimate` times


@dataclass(frozen=True)
class Counts:
    """Numbers of points of a study: all ``points``, finished ones (``done``), and ``failed`` ones among the finished.

    If a study compares many bags (see `fleet`), each point is a bag.
    """

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


@dataclass(frozen=True)
class Estimate:
    """Approximate cost of a study: number of ``blocks``, and ``seconds`` on a number of ``workers``."""

    blocks: int
    seconds: float
    workers: int


def estimate(study: Study, workers: Workers, say: Say) -> Estimate:
    """Estimate the cost of a study from the duration of a few points, which are computed in this process.

    A worker of a cluster is assumed to be as fast as one core of this machine.
    """
    rows = study.points().reshape(study.size, -1)
    rows = rows[:: max(1, study.size // _TIMED_POINTS)][:_TIMED_POINTS]
    compute_block(study, rows[:1])  # the first call may compile
    begin = time.process_time()
    compute_block(study, rows)
    each = (time.process_time() - begin) / len(rows)
    many = workers.number or cores()
    if workers.scheduler:
        with connected(workers.scheduler, 0, say) as client:
            many = max(1, len(client.scheduler_info(n_workers=-1)["workers"]))
    blocks = len(regions(study.shape, block_shape(study)))
    return Estimate(blocks, each * study.size / many, many)


def run_study(
    study: Study, output: Path, workers: Workers, say: Say, progress: Callable[[float], None]
) -> Counts:
    """Compute the unfinished and the damaged points of a study into ``output``.

    If this fails, finished blocks remain, and calling it again computes the others.

    Args:
        study: study.
        output: folder of the store.
        workers: workers to use.
        say: function that is called with each message.
        progress: function that is called with the finished share of the points, 0 to 1.

    Raises:
        StoreError: The output cannot be used.
        ClusterError: The cluster cannot be used.
        LostError: The cluster was lost.
        OSError: The output cannot be written.
    """
    return _run(study, output, workers, say, progress, _open_blocks)


def retry_study(
    study: Study, output: Path, workers: Workers, say: Say, progress: Callable[[float], None]
) -> Counts:
    """Like `run_study`, but also compute the blocks with failed points again."""
    return _run(study, output, workers, say, progress, _open_and_failed_blocks)


def verify_store(path: Path, say: Say) -> tuple[Counts, int]:
    """Compare all blocks of a store with their checksums, and report the damaged ones.

    Returns:
        The counts, and the number of damaged points.
    """
    with existing_store(path) as store:
        audit = store.audit()
        _report(store, audit, say)
        return Counts(store.study.size, *store.counts()), sum(map(points_of, audit.damaged))


def points_of(block: Region) -> int:
    """Return the number of points of a block."""
    return math.prod(part.stop - part.start for part in block)


def _report(store: Store, audit: Audit, say: Say) -> None:
    for name in store.repaired:
        say(f"{store.path / name} was missing or damaged, and is restored")
    for file in audit.unreadable:
        say(f"{file} is damaged: it cannot be decoded")
    if audit.damaged:
        number = sum(map(points_of, audit.damaged))
        first = _place(store.study, audit.damaged[0])
        say(
            f"{store.path}: values of {number} points are missing or damaged "
            f"({len(audit.damaged)} blocks, the first at {first})"
        )


def _open_blocks(audit: Audit) -> list[Region]:
    return [*audit.unfinished, *audit.damaged]


def _open_and_failed_blocks(audit: Audit) -> list[Region]:
    return [*_open_blocks(audit), *audit.failed]


def _starts(block: Region) -> tuple[int, ...]:
    return tuple(part.start for part in block)


def _place(study: Study, block: Region) -> str:
    ends = zip(study.dimensions, block, strict=True)
    return ", ".join(f"{name} {part.start} to {part.stop - 1}" for name, part in ends)


def _run(
    study: Study,
    output: Path,
    workers: Workers,
    say: Say,
    progress: Callable[[float], None],
    choose: Callable[[Audit], list[Region]],
) -> Counts:
    with locked_store(output, study) as store:
        audit = store.audit()
        _report(store, audit, say)
        todo = sorted(choose(audit), key=_starts)
        if audit.damaged:
            say("computing the damaged points again")
            store.reset(audit)
        if todo:
            with connected(workers.scheduler, workers.number or cores(), say) as client:
                _compute(client, store, todo, say, progress)
        counts = store.counts()
    return Counts(study.size, *counts)


def _compute(
    client: Client, store: Store, todo: list[Region], say: Say, progress: Callable[[float], None]
) -> None:
    study, points = store.study, store.points
    done = study.size - sum(map(points_of, todo))
    progress(done / study.size)
    pieces = ((study, points[block].reshape(-1, points.shape[-1])) for block in todo)
    try:
        for place, results in spread(client, compute_block, pieces, say):
            store.write(todo[place], results)
            done += points_of(todo[place])
            progress(done / study.size)
    except (LostError, OSError) as error:
        stays = f"{done} of {study.size} points are in {store.path}: repeat the command to continue"
        raise type(error)(f"{error}; {stays}") from None
