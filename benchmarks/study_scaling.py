# SPDX-License-Identifier: Apache-2.0
"""Cost of distributing a study, and its growth with points and workers."""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from benchmarks.report import Row
from worm_optimizer.study.blocks import Workers
from worm_optimizer.study.point import compute_block
from worm_optimizer.study.study_file import Study, load_study
from worm_optimizer.study.study_run import run_study

TITLE = "overhead of blocks against the batch simulator alone, points, workers"
_POINTS = 16
_STUDY = """\
vary: {{slack: {{from: 0.004, to: 0.010, count: {points}}}}}
fixed: {{margin_m: 0.002}}
compute: [front, gaits]
"""


def study_of(points: int) -> Study:
    """Return a study with the default resolution."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "study.yaml"
        file.write_text(_STUDY.format(points=points))
        return load_study(file)


def timed(work: Callable[[], object]) -> float:
    """Return the duration of a call, s."""
    begin = time.perf_counter()
    work()
    return time.perf_counter() - begin


def through(study: Study, workers: int) -> float:
    """Return the duration of a study, s, from the start of its workers to the result on disk."""
    with tempfile.TemporaryDirectory() as folder:
        output = Path(folder) / "study.nc"
        return timed(lambda: run_study(study, output, Workers("", workers), print, lambda _: None))


def run() -> list[Row]:
    """Measure for some forty seconds on two free cores."""
    short, long = study_of(_POINTS), study_of(2 * _POINTS)
    compute_block(short, short.points()[:1])  # compiled kernels
    alone = timed(lambda: compute_block(short, short.points()))
    seconds = {many: (through(short, many), through(long, many)) for many in (1, 2)}
    more = {many: last - first for many, (first, last) in seconds.items()}
    what = f"{_POINTS} fronts more, workers already started"
    cores = os.cpu_count()
    return [
        Row("the batch simulator alone", f"{alone:.2f} s", "", f"one process, {cores} cores"),
        Row("one worker", f"{more[1]:.2f} s", "", what),
        Row("two workers", f"{more[2]:.2f} s", "", what),
        Row("start of two workers", f"{seconds[2][0] - more[2]:.1f} s", "", "and first import"),
        Row(
            "two workers over the simulator alone",
            f"{more[2] / alone:.2f}",
            "< 1.10",
            "clock time; above 1 is what distributing costs",
        ),
    ]
