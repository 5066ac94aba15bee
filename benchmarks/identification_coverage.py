# SPDX-License-Identifier: Apache-2.0
"""Coverage of the 95 % intervals of an identification: how often they contain the true value of virtual robots."""

from __future__ import annotations

import os
import sys
from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from benchmarks.report import Row, wall_time
from tests.helpers.foreign_robot import some_robot
from tests.helpers.lab_files import write_foreign_lab
from tests.helpers.virtual_campaign import CAMPAIGN, SPREAD, virtual_campaign
from worm_model.errors import IdentificationError
from worm_model.identification.fits.estimate import Estimate
from worm_model.identification.inputs import read_inputs
from worm_model.identification.reference_values import MEASURED, reference_by_folder
from worm_model.identification.report.identification_report import code_version
from worm_model.identification.stages import Identification, identify
from worm_model.parameters import KEYS

TITLE = "how often the 95 % intervals of an identification cover the truth (minutes; WORM_BENCH_CASES=5 for fewer)"
CASES = 40
GOAL = 0.9
LAB = Path(__file__).resolve().parents[1] / "../shared/campaign"
SECONDS = 60  # for the lab's runs on two cores
IDENTIFIED = [key for key in KEYS if key not in MEASURED or key == "pitch"]
COMPLIANT_CASES, FOREIGN_CASES = 6, 5
CABLE_N_PER_M = 6400.0
# Parameters that a robot with a compliant cable has, too, and the foreign robot's names of them
FOREIGN_KEYS = {
    "viscous_friction": "viscous_friction",
    "switching_threshold": "threshold",
    "bellows_stiffness": "bellows_stiffness",
    "clearance": "clearance",
    "engaged_stiffness": "engaged_stiffness",
    "disengaged_stiffness": "disengaged_stiffness",
}


@dataclass(frozen=True)
class Case:
    """True values of a robot and their estimates, by key; ``rejected`` is the reason if there are no estimates."""

    seed: int
    truth: dict[str, float]
    estimates: dict[str, Estimate]
    rejected: str = ""
    verdict: str = ""

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
    return _case(seed, truth, lambda: identify(campaign.inputs, campaign.reference))


def compliant_case(seed: int) -> Case:
    """Identify a virtual robot with a compliant cable, which cannot push."""
    campaign = virtual_campaign(seed, CAMPAIGN, SPREAD, CABLE_N_PER_M)
    truth = {key: getattr(campaign.truth, key) for key in FOREIGN_KEYS}
    return _case(seed, truth, lambda: identify(campaign.inputs, campaign.reference))


def foreign_case(seed: int) -> Case:
    """Identify a robot that the model does not contain from the files of a lab."""
    robot = some_robot(seed)
    truth = {key: getattr(robot, name) for key, name in FOREIGN_KEYS.items()}
    with TemporaryDirectory() as folder:
        lab = write_foreign_lab(Path(folder) / "lab", robot)
        return _case(seed, truth, lambda: identify(read_inputs([lab]), reference_by_folder(lab)))


def _case(seed: int, truth: dict[str, float], identified: Callable[[], Identification]) -> Case:
    try:
        result = identified()
    except IdentificationError as error:
        return Case(seed, truth, {}, str(error))
    estimates = {key: result.estimates[key] for key in truth}
    return Case(seed, truth, estimates, verdict=result.fit.verdict.value)


def rows_of(cases: Sequence[Case], kind: str, goal: str) -> list[Row]:
    """Return the number of rejected robots, their verdicts, and the coverage and width of every parameter.

    ``kind`` describes the robots, ``goal`` names the expected verdicts.
    """
    rejected = sum(bool(c.rejected) for c in cases)
    verdicts = Counter(c.verdict for c in cases if not c.rejected)
    how = f"{kind}, {code_version()}"
    return [
        Row("robots whose identification was rejected", f"{rejected} of {len(cases)}", "0", how),
        Row("verdicts", ", ".join(f"{n} {v}" for v, n in verdicts.items()), goal, kind),
        *(row(key, cases, kind) for key in cases[0].truth),
    ]


def row(key: str, cases: Sequence[Case], kind: str) -> Row:
    """Return the coverage and width of one parameter."""
    known = [c for c in cases if c.has_interval(key)]
    if not known:
        return Row(key, "no interval", f">= {GOAL:.0%}", kind)
    covered = sum(c.covers(key) for c in known)
    width = np.median([c.estimates[key].spread / c.truth[key] for c in known])
    return Row(
        key,
        f"{covered} of {len(known)}",
        f">= {GOAL:.0%}",
        f"{kind}; half-width {100 * width:.2f} % (median)",
    )


def comment(done: Case) -> str:
    """Return the result of one robot in one line."""
    if done.rejected:
        return f"robot {done.seed}: rejected: {done.rejected}"
    known = [key for key in done.truth if done.has_interval(key)]
    missed = ", ".join(key for key in known if not done.covers(key)) or "none"
    open_keys = ", ".join(key for key in done.truth if key not in known) or "none"
    return f"robot {done.seed}: {done.verdict}; missed: {missed}; no interval: {open_keys}"


def timing() -> list[Row]:
    """Measure an identification from the lab's eight runs; return no rows without them."""
    if not LAB.is_dir():
        return []

    def once() -> None:
        inputs = read_inputs([LAB])
        identify(inputs, reference_by_folder(LAB))

    return [
        Row(
            "identify the lab's campaign",
            f"{wall_time(once, 1):.1f} s",
            f"< {SECONDS} s",
            f"{len(read_inputs([LAB]).recordings)} runs and two bench tests, {os.cpu_count()} cores, once",
        )
    ]


def run() -> list[Row]:
    """Return the table of coverage: scattered grooves, dry friction, slack, quantisation, noise, misread rulers.

    Robots with a compliant cable and robots that the model does not contain follow, with their verdicts.
    """
    found = timing()
    most = int(os.environ.get("WORM_BENCH_CASES", CASES))
    with ProcessPoolExecutor() as pool:
        for kind, one, count, goal in (
            ("seeded robots", case, CASES, "fits"),
            ("compliant cable", compliant_case, COMPLIANT_CASES, "roughly"),
            ("foreign robots", foreign_case, FOREIGN_CASES, "roughly or does_not_fit"),
        ):
            cases = []
            for done in pool.map(one, range(1, min(count, most) + 1)):
                cases.append(done)
                print(f"identification_coverage: {comment(done)}", file=sys.stderr, flush=True)
            found += rows_of(cases, kind, goal)
    return found
