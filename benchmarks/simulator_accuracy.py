# SPDX-License-Identifier: Apache-2.0
"""Difference of the simulator from the tests' independent integration, for a thousand random robots and gaits."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor

import numpy as np

from benchmarks.report import Row
from tests.helpers.oracle import Oracle
from tests.helpers.random_cases import random_case
from worm_model.simulation.simulator import evaluate_gait, simulate

TITLE = "agreement with an independent integration (minutes)"
CASES = int(os.environ.get("WORM_BENCH_CASES", "1000"))


Comparison = tuple[float, float, bool]


def compare(seed: int) -> Comparison | None:
    """Return (relative error of power, largest error of x1 at the start of a cycle in m, switches equal) of a case.

    Return None if the independent integration may have stepped over an event.
    """
    _, gait, parameters = random_case(seed)
    result = evaluate_gait(gait, parameters)
    try:
        oracle = Oracle(gait, parameters).run()
    except AssertionError:
        return None
    starts = simulate(gait, parameters).at(np.arange(6) * gait.period)
    error = np.abs(starts.x1 - [x1 for x1, _ in oracle.boundaries]).max()
    power = parameters.idle_power + parameters.power_factor * oracle.work(3) * gait.frequency
    return abs(result.power / power - 1.0), float(error), result.switches == oracle.switches


def _compare_all() -> Iterator[Comparison | None]:
    with ProcessPoolExecutor() as pool:
        for done, outcome in enumerate(pool.map(compare, range(CASES), chunksize=5), start=1):
            if done % max(CASES // 10, 1) == 0:
                print(f"  {done} of {CASES} cases", file=sys.stderr, flush=True)
            yield outcome


def run() -> list[Row]:
    """Measure."""
    outcomes = list(_compare_all())
    compared = [outcome for outcome in outcomes if outcome is not None]
    power, position, same = (np.array(column) for column in zip(*compared, strict=True))
    how = f"{CASES} seeded random gaits and robots against DOP853 at 1e-10, events located"
    return [
        Row("largest error of power", f"{power.max():.1e}", "1e-6", f"relative; {how}"),
        Row(
            "largest error of x1", f"{position.max() * 1e9:.1e} nm", "1 nm", "at the cycles' starts"
        ),
        Row("cases with other switch counts", f"{np.count_nonzero(~same)}", "0", ""),
        Row(
            "cases left out",
            f"{len(outcomes) - len(compared)}",
            "0",
            "the oracle is not sure of them",
        ),
    ]
