# SPDX-License-Identifier: Apache-2.0
"""Tuning of a gait on the robot: run it, measure its margins, and repeat with the next gait."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from worm_model.gait import Gait
from worm_optimizer.robustness.tuning import TuneState, Tuning

MOST_RUNS = 5

#: Runs a gait and returns its bag. Arguments: the gait, and the number of the run from 1. Raises an exception to end.
Record = Callable[[Gait, int], Path]
#: Returns the next step from the bags so far. Raises an exception if the last run was not measured.
Measure = Callable[[Sequence[Path]], Tuning]


@dataclass(frozen=True)
class Tuned:
    """Last step of a tuning, and the bags of its runs. In the state `RUN` the runs did not suffice."""

    step: Tuning
    bags: tuple[Path, ...]


def tune_gait(gait: Gait, record: Record, measure: Measure, say: Callable[[str], None]) -> Tuned:
    """Run a gait and its successors, at most `MOST_RUNS` in total, until one is done or none is possible.

    Args:
        gait: the first gait.
        record: runs and records a gait.
        measure: the step after the bags so far.
        say: called with each line of progress.
    """
    bags: list[Path] = []
    for number in range(1, MOST_RUNS + 1):
        say(
            f"run {number} of at most {MOST_RUNS}: {1e3 * gait.stroke:.1f} mm, {gait.frequency:.4g} Hz"
        )
        bags.append(record(gait, number))
        step = measure(bags)
        if step.state is not TuneState.RUN:
            break
        gait = step.gait
    return Tuned(step, tuple(bags))
