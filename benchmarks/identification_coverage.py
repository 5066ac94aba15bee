# SPDX-License-Identifier: Apache-2.0
"""How often the 95 % intervals of an identification cover the truth, over seeded virtual robots."""

from __future__ import annotations

import os
import sys
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass

import numpy as np

from benchmarks.report import Row
from tests.virtual_campaign import virtual_campaign
from worm_model.identification.estimate import Estimate
from worm_model.identification.given import MEASURED
from worm_model.identification.pipeline import identify
from worm_model.parameters import KEYS

TITLE = "how often the 95 % intervals of an identification cover the truth (minutes; WORM_BENCH_CASES=5 for fewer)"
CASES = 40
GOAL = 0.9
IDENTIFIED = [key for key in KEYS if key not in MEASURED]


@dataclass(frozen=True)
class Case:
    """A robot's true values and the estimates of them, by key."""

    seed: int
    truth: dict[str, float]
    estimates: dict[str, Estimate]

    def covers(self, key: str) -> bool:
        """Whether the truth lies in the interval."""
        return self.estimates[key].low <= self.truth[key] <= self.estimates[key].high


def case(seed: int) -> Case:
    """Eight runs and two bench tests of a robot, identified."""
    campaign = virtual_campaign(seed)
    result = identify(campaign.inputs, campaign.given, seed)
    truth = {key: getattr(campaign.truth, key) for key in IDENTIFIED}
    return Case(seed, truth, {key: result.estimates[key] for key in IDENTIFIED})


def row(key: str, cases: list[Case]) -> Row:
    """Coverage and width of one parameter."""
    told = [c for c in cases if c.estimates[key].identifiable]
    covered = sum(c.covers(key) for c in told)
    width = np.median([c.estimates[key].spread / c.truth[key] for c in told])
    return Row(
        key,
        f"{covered} of {len(told)}",
        f">= {GOAL:.0%}",
        f"seeded robots; half-width {100 * width:.2f} % (median)",
    )


def run() -> list[Row]:
    """The table of coverage: scattered grooves, dry friction, slack, quantised instruments, noise."""
    count = int(os.environ.get("WORM_BENCH_CASES", CASES))
    cases = []
    with ProcessPoolExecutor() as pool:
        for done in pool.map(case, range(1, count + 1)):
            cases.append(done)
            missed = [key for key in IDENTIFIED if not done.covers(key)]
            note = f", missed: {', '.join(missed)}" if missed else ""
            print(
                f"identification_coverage: robot {done.seed} of {count}{note}",
                file=sys.stderr,
                flush=True,
            )
    return [row(key, cases) for key in IDENTIFIED]
