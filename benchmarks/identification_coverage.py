# SPDX-License-Identifier: Apache-2.0
"""Coverage of the 95 % intervals of an identification: how often they contain the true value of virtual robots."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.report import Row, wall_time
from tests.helpers.virtual_campaign import virtual_campaign
from worm_model.identification.data.identification_errors import IdentificationError
from worm_model.identification.fingerprint import code_version
from worm_model.identification.fits.estimate import Estimate
from worm_model.identification.inputs import read_inputs
from worm_model.identification.reference_values import MEASURED, reference_by_folder
from worm_model.identification.stages import identify
from worm_model.parameters import KEYS

TITLE = "how often the 95 % intervals of an identification cover the truth (minutes; WORM_BENCH_CASES=5 for fewer)"
CASES = 40
GOAL = 0.9
LAB = Path(__file__).resolve().parents[1] / "../shared/campaign"
SECONDS = 60  # for the lab's runs on two cores
IDENTIFIED = [key for key in KEYS if key not in MEASURED or key == "pitch"]


@dataclass(frozen=True)
class Case:
    """True values of a robot and their estimates, by key; ``rejected`` is the reason if there are no estimates."""

    seed: int
    truth: dict[str, float]
    estimates: dict[str, Estimate]
    rejected: str = ""

    def has_interval(self, key: str) -> bool:
        """True if there is an interval."""
        return not self.rejected and self.estimates[key].identifiable

    def covers(self, key: str) -> bool:
        """True if the interval contains the true value."""
        return self.estimates[key].low <= self.truth[key] <= self.estimates[key].high


def case(seed: int) -> Case:
    """Identify a robot from eight runs and two bench tests."""
    campaign = virtual_campaign(seed)
    truth = {key: getattr(campaign.truth, key) for key in IDENTIFIED}
    try:
        result = identify(campaign.inputs, campaign.reference, seed)
    except IdentificationError as error:
        return Case(seed, truth, {}, str(error))
    return Case(seed, truth, {key: result.estimates[key] for key in IDENTIFIED})


def rows_of(cases: Sequence[Case]) -> list[Row]:
    """Return the number of rejected robots, and the coverage and width of every parameter."""
    rejected = sum(bool(c.rejected) for c in cases)
    how = f"seeded robots, {code_version()}"
    first = Row("robots whose identification was rejected", f"{rejected} of {len(cases)}", "0", how)
    return [first, *(row(key, cases) for key in IDENTIFIED)]


def row(key: str, cases: Sequence[Case]) -> Row:
    """Return the coverage and width of one parameter."""
    known = [c for c in cases if c.has_interval(key)]
    if not known:
        return Row(key, "no interval", f">= {GOAL:.0%}", "seeded robots")
    covered = sum(c.covers(key) for c in known)
    width = np.median([c.estimates[key].spread / c.truth[key] for c in known])
    return Row(
        key,
        f"{covered} of {len(known)}",
        f">= {GOAL:.0%}",
        f"seeded robots; half-width {100 * width:.2f} % (median)",
    )


def comment(done: Case) -> str:
    """Return the result of one robot in one line."""
    if done.rejected:
        return f"robot {done.seed}: rejected: {done.rejected}"
    known = [key for key in IDENTIFIED if done.has_interval(key)]
    missed = ", ".join(key for key in known if not done.covers(key)) or "none"
    open_keys = ", ".join(key for key in IDENTIFIED if key not in known) or "none"
    return f"robot {done.seed}: missed: {missed}; no interval: {open_keys}"


def timing() -> list[Row]:
    """Measure an identification from the lab's eight runs; return no rows without them."""
    if not LAB.is_dir():
        return []

    def once() -> None:
        inputs = read_inputs([LAB])
        identify(inputs, reference_by_folder(LAB), 0)

    return [
        Row(
            "identify the lab's campaign",
            f"{wall_time(once, 1):.1f} s",
            f"< {SECONDS} s",
            f"{len(read_inputs([LAB]).recordings)} runs and two bench tests, {os.cpu_count()} cores, once",
        )
    ]


def run() -> list[Row]:
    """Return the table of coverage: scattered grooves, dry friction, slack, quantisation, noise, misread rulers."""
    found = timing()
    count = int(os.environ.get("WORM_BENCH_CASES", CASES))
    cases = []
    with ProcessPoolExecutor() as pool:
        for done in pool.map(case, range(1, count + 1)):
            cases.append(done)
            print(f"identification_coverage: {comment(done)}", file=sys.stderr, flush=True)
    return found + rows_of(cases)
