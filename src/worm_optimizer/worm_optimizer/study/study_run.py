# SPDX-License-Identifier: Apache-2.0
"""Run of a study: unfinished points are computed block by block and stored."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from distributed import Client

from worm_model.simulation.batch import evaluate_gaits
from worm_optimizer.study.engine import LostError, Say, connected, cores, spread
from worm_optimizer.study.plan import Study
from worm_optimizer.study.point import compute_block
from worm_optimizer.study.store import Store, held

_TIMED_GAITS = 2048  # they take some hundredths of a second


@dataclass(frozen=True)
class Counts:
    """Number of ``points`` of a study, of the finished ones (``done``), and of the ``failed`` ones among these."""

    points: int
    done: int
    failed: int


@dataclass(frozen=True)
class Estimate:
    """Approximate cost of a study: evaluated ``gaits`` and ``seconds`` on a number of ``workers``."""

    gaits: float
    seconds: float
    workers: int


def estimate(study: Study, scheduler: str, workers: int | None) -> Estimate:
    """Estimate the cost of a study from a few gaits that are timed here.

    A worker of a cluster is assumed to be as fast as one core of this machine.
    """
    row = np.linspace(0.0, 1.0, _TIMED_GAITS)
    gaits = 0.01 + 0.08 * row, 0.08 + 0.32 * (7.0 * row % 1.0), 0.002
    evaluate_gaits(*gaits)  # the first call compiles
    begin = time.process_time()
    evaluate_gaits(*gaits)
    each = (time.process_time() - begin) / _TIMED_GAITS
    many = workers or cores()
    if scheduler:
        with connected(scheduler, 0) as client:
            many = max(1, len(client.scheduler_info(n_workers=-1)["workers"]))
    total = study.size * study.gaits_per_point
    return Estimate(total, each * total / many, many)


def run_study(
    study: Study,
    output: Path,
    scheduler: str,
    workers: int | None,
    say: Say,
    progress: Callable[[float], None],
) -> Counts:
    """Compute the unfinished points of a study into ``output``.

    If the call fails, finished blocks remain, and the same call continues with the others.

    Args:
        study: study.
        output: folder of the store.
        scheduler: address of a Dask scheduler, or an empty string for workers on this machine.
        workers: number of workers on this machine; None for one per core.
        say: function that is called with each message.
        progress: function that is called with the finished share.

    Raises:
        StoreError: The output cannot be used.
        ClusterError: The cluster cannot be used.
        LostError: The cluster was lost.
        OSError: The disk is full.
    """
    with held(output, study) as store:
        todo = store.open_blocks()
        if todo:
            with connected(scheduler, workers or cores()) as client:
                _compute(client, store, todo, say, progress)
        done, failed = store.counts()
    return Counts(study.size, done, failed)


def _compute(
    client: Client, store: Store, todo: list[slice], say: Say, progress: Callable[[float], None]
) -> None:
    points = store.study.points()
    done = store.study.size - sum(block.stop - block.start for block in todo)
    progress(done / store.study.size)
    pieces = ((store.study, points[block]) for block in todo)
    try:
        for place, results in spread(client, compute_block, pieces, say):
            store.write(todo[place], results)
            done += todo[place].stop - todo[place].start
            progress(done / store.study.size)
    except (LostError, OSError) as error:
        stays = (
            f"{done} of {store.study.size} points are in {store.path}: repeat the command to go on"
        )
        raise type(error)(f"{error}; {stays}") from None
