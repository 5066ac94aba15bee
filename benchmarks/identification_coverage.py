# SPDX-License-Identifier: Apache-2.0
"""How often the 95 % intervals of an identification cover the truth, over seeded virtual robots."""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping

import numpy as np

from benchmarks.report import Row
from tests.virtual_campaign import virtual_campaign
from worm_model.identification.given import MEASURED
from worm_model.identification.pipeline import identify
from worm_model.parameters import KEYS

TITLE = "how often the 95 % intervals of an identification cover the truth (minutes; WORM_BENCH_CASES=5 for fewer)"
CASES = 20
GOAL = 0.9


def coverage(cases: int) -> tuple[dict[str, list[bool]], dict[str, list[float]], list[str]]:
    """By key and case: whether the interval covers, its half-width relative to the truth; and the misses in words."""
    covered: dict[str, list[bool]] = {key: [] for key in KEYS if key not in MEASURED}
    widths: dict[str, list[float]] = {key: [] for key in covered}
    misses = []
    for seed in range(1, cases + 1):
        campaign = virtual_campaign(seed)
        result = identify(campaign.inputs, campaign.given, seed)
        for key in covered:
            estimate, true = result.estimates[key], getattr(campaign.truth, key)
            if not estimate.identifiable:
                continue
            covered[key].append(estimate.low <= true <= estimate.high)
            widths[key].append(estimate.spread / true)
            if not covered[key][-1]:
                misses.append(
                    f"seed {seed}: {key} {estimate.low:g} to {estimate.high:g} misses {true:g}"
                )
        done = {key: sum(values) for key, values in covered.items()}
        print(
            f"identification_coverage: seed {seed} of {cases}: {done}", file=sys.stderr, flush=True
        )
    return covered, widths, misses


def rows(covered: Mapping[str, list[bool]], widths: Mapping[str, list[float]]) -> list[Row]:
    """One for each parameter."""
    return [
        Row(
            key,
            f"{sum(values)} of {len(values)}",
            f">= {GOAL:.0%}",
            f"half-width {100 * float(np.median(widths[key])):.2f} % (median)",
        )
        for key, values in covered.items()
    ]


def run() -> list[Row]:
    """The table of coverage: eight runs and two bench tests of each robot, scattered grooves, dry friction, noise."""
    covered, widths, misses = coverage(int(os.environ.get("WORM_BENCH_CASES", CASES)))
    for miss in misses:
        print(f"identification_coverage: {miss}", file=sys.stderr)
    return rows(covered, widths)
