# SPDX-License-Identifier: Apache-2.0
"""Cost of distributing a study, and its growth with points and workers."""

from __future__ import annotations

import dataclasses
import math
import os
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from distributed import Client

from benchmarks.report import Row
from worm_optimizer.study.engine import connected, spread
from worm_optimizer.study.plan import Array, Study
from worm_optimizer.study.point import compute_block
from worm_optimizer.study.store import locked_store
from worm_optimizer.study.study_file import parse_study

TITLE = "overhead of blocks against the batch simulator alone, points, workers"
_POINTS, _BLOCK = 16, 4
_STUDY = """\
vary: {{slack: {{from: 0.004, to: 0.010, count: {points}}}}}
fixed: {{margin_m: 0.002}}
compute: [front, gaits]
block_points: {block}
"""


def study_of(points: int) -> Study:
    """Return a study with the default resolution."""
    return parse_study(_STUDY.format(points=points, block=_BLOCK), Path())


def timed(work: Callable[[], object]) -> float:
    """Return the duration of a call, s."""
    begin = time.perf_counter()
    work()
    return time.perf_counter() - begin


def through(client: Client, study: Study) -> float:
    """Return the time from the submission of the first block to the storage of the last one, s."""
    with (
        tempfile.TemporaryDirectory() as folder,
        locked_store(Path(folder) / "study.zarr", study) as store,
    ):
        blocks = store.blocks()
        pieces = ((study, rows_of(store.points[block])) for block in blocks)

        def work() -> None:
            for place, results in spread(client, compute_block, pieces, print):
                store.write(blocks[place], results)

        return timed(work)


def rows_of(points: Array) -> Array:
    """Return the points as rows."""
    return points.reshape(-1, points.shape[-1])


def alone(study: Study) -> float:
    """Return the duration (s) of the same computations in this process, without workers or disk, on all its cores."""
    return timed(lambda: compute_block(study, rows_of(study.points())))


def run() -> list[Row]:
    """Measure for some twenty seconds on two free cores."""
    short, long = study_of(_POINTS // 2), study_of(_POINTS)
    warm = dataclasses.replace(short, block_points=1)
    alone(warm)
    seconds = {}
    for workers in (1, 2):
        with connected("", workers, print) as client:
            through(client, warm)  # imports and compiled kernels
            seconds[workers] = through(client, short), through(client, long)
    here = alone(long)
    cores = os.cpu_count()
    what = f"{_POINTS} fronts in {math.ceil(_POINTS / _BLOCK)} blocks"
    return [
        Row(
            "the batch simulator alone", f"{here:.2f} s", "", f"{what}, one process, {cores} cores"
        ),
        Row(
            "one worker",
            f"{_POINTS / seconds[1][1]:.2f} points/s",
            "",
            f"{what}, {seconds[1][1]:.2f} s to the last byte on disk",
        ),
        Row("two workers", f"{_POINTS / seconds[2][1]:.2f} points/s", "", "the same"),
        Row(
            "two workers over the simulator alone",
            f"{seconds[2][1] / here:.2f}",
            "< 1.10",
            "clock time; above 1 is what distributing costs",
        ),
        Row(
            "one worker over two",
            f"{seconds[1][1] / seconds[2][1]:.2f}",
            "",
            "clock time; a worker alone runs the simulator on all cores too",
        ),
        Row(
            "twice the points",
            f"{seconds[2][1] / seconds[2][0]:.2f}",
            "2",
            f"time of {_POINTS} over that of {_POINTS // 2} points, two workers",
        ),
    ]
