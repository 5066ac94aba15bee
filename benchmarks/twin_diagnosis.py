# SPDX-License-Identifier: Apache-2.0
"""What the twin makes of robots with something wrong: the cause it names, against the true one, over seeded runs.

The robots are integrated step by step (tests/faulty_robots.py), are off the twin's parameters, have dry friction,
grooves that differ and noisy instruments. Each fault begins in the second to the fourth cycle of five.
"""

from __future__ import annotations

import math
import os
from collections import Counter, defaultdict
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass

import numpy as np

from benchmarks.report import Row
from tests.faulty_robots import ONSET, Fault, Lab, Robots, run_robots
from worm_model.gait import Gait
from worm_model.parameters import PAPER
from worm_model.simulation.simulator import evaluate_gait
from worm_model.twin.causes import SCATTER
from worm_model.twin.cycle_data import POWER_SHARE
from worm_model.twin.signatures import FAULTS, OFFSET_W, SCALE, SLIP_M, signatures
from worm_model.twin.twin import Twin

TITLE = (
    "diagnosis of the twin: right cause within two cycles, and false alarms, in runs of five cycles"
)
GAITS = (Gait(0.08, 0.2), Gait(0.06, 0.3), Gait(0.085, 0.25))
REPEATS = 4  # of each fault and size with each gait
SOUND = 60  # runs with each gait
CYCLES_LATE = 2.05  # cycles after that of the fault in which a cause is named in time
#: three sizes of each kind, small to large
SIZES: dict[str, tuple[float, ...]] = {
    "rear": (1, 1, 2),
    "front": (1, 1, 2),
    "gained": (1, 1, 1),
    "gain": (-0.01, -0.03, -0.06),
    "slip": (0.001, 0.003, 0.006),
    "friction": (0.5, 1.0, 2.0),
    "less friction": (-0.3, -0.6, -0.8),
    "scale": (0.04, 0.10, 0.20),
    "offset": (0.1, 0.3, 0.6),
    "robot": (1, 3, 5),
    "camera": (0.004, 0.012, 0.040),
}
CODES = {
    "rear": "missed_groove_rear",
    "front": "missed_groove_front",
    "gained": "gained_groove",
    "gain": "cable_slip",
    "slip": "cable_slip",
    "friction": "friction_up",
    "less friction": "friction_down",
    "scale": "power_scale",
    "offset": "power_offset",
    "robot": "robot_moved",
    "camera": "camera_moved",
}
UNITS = {
    "gain": 100.0,
    "slip": 1e3,
    "friction": 100.0,
    "less friction": 100.0,
    "scale": 100.0,
    "camera": 1e3,
}


@dataclass(frozen=True)
class Outcome:
    """Of a run: what was wrong, its size's place (0 to 2), and the first code told, "" for none; ``late`` in cycles."""

    kind: str
    size: int
    tracker: bool
    told: str
    late: float


def faults(gait: Gait) -> list[tuple[str, int, Fault]]:
    """(kind, place of the size, fault) of all runs with a gait; grooves and pushes begin with a cycle."""
    found = [("sound", 0, Fault()) for _ in range(SOUND)]
    for kind, sizes in SIZES.items():
        for place, size in enumerate(sizes):
            for k in range(REPEATS):
                whole = kind in ("rear", "front", "gained")
                phase = 0.0 if whole else 0.3 * ((k + place) % 3)
                plant_kind = "friction" if kind == "less friction" else kind
                found.append((kind, place, Fault(plant_kind, size, 2 + k % 3, phase)))
    return found


def outcomes(gait: Gait, seed: int = 11, lab: Lab = Lab()) -> list[Outcome]:
    """Every run with a gait, followed with and without a tracker."""
    wanted = faults(gait)
    usual = round(evaluate_gait(gait).grooves_per_cycle)
    robots = run_robots(gait, [f for _, _, f in wanted], seed=seed, lab=lab, usual=usual)
    return [
        _outcome(robots, k, kind, place, fault, tracker)
        for k, (kind, place, fault) in enumerate(wanted)
        for tracker in (True, False)
    ]


def _outcome(robots: Robots, k: int, kind: str, place: int, fault: Fault, tracker: bool) -> Outcome:
    twin = Twin()
    events = twin.advance(twin.start(), robots.rows(k, tracker=tracker), to_the_end=True).events
    coded = [event for event in events if event.code]
    if not coded:
        return Outcome(kind, place, tracker, "", math.nan)
    late = (coded[0].stamp_ns - ONSET) * 1e-9 / robots.gait.period - fault.cycle
    return Outcome(kind, place, tracker, coded[0].code, late)


def right(outcome: Outcome) -> bool:
    """Whether the cause was named, and in time."""
    if outcome.kind == "sound":
        return not outcome.told
    return outcome.told == CODES[outcome.kind] and outcome.late <= CYCLES_LATE - 1.0


def bound(gait: Gait, kind: str, place: int) -> float:
    """How often somebody who knew robot, noise and size would see a fault in two cycles of power, missing one in 100.

    Power alone: the signal-to-noise ratio of its signature against the scatter that the twin takes for sound.
    """
    signs = signatures(gait, PAPER, driven=False)
    size = SIZES[kind][place]
    usual = {"gain": FAULTS["gain"], "slip": SLIP_M, "scale": SCALE, "offset": OFFSET_W}
    if kind in ("rear", "front"):
        changes = list(signs.missed[kind][:, 2])
    elif kind == "gained":
        changes = list(next(iter(signs.gained.values()))[:, 2])
    elif kind in ("robot", "camera"):
        return 0.0
    else:
        name = "viscous_friction" if "friction" in kind else kind
        unit = FAULTS["viscous_friction"] if "friction" in kind else usual[kind]
        changes = [signs.lasting[name][2] * size / unit] * 2
    noise = SCATTER[2] + POWER_SHARE * signs.power
    distance = math.sqrt(sum(float(np.sum((change / noise) ** 2)) for change in changes))
    return 0.5 * math.erfc((2.33 - distance) / math.sqrt(2.0))


def table(found: Sequence[Outcome], tracker: bool) -> dict[tuple[str, int], Counter[str]]:
    """What was told, by kind and size."""
    counts: dict[tuple[str, int], Counter[str]] = defaultdict(Counter)
    for outcome in found:
        if outcome.tracker == tracker:
            in_time = (
                outcome.kind == "sound" or not outcome.told or outcome.late <= CYCLES_LATE - 1.0
            )
            counts[outcome.kind, outcome.size][outcome.told if in_time else "too late"] += 1
    return counts


def measure() -> list[Outcome]:
    """All outcomes; the gaits on all cores."""
    with ProcessPoolExecutor(min(len(GAITS), os.cpu_count() or 1)) as pool:
        return [outcome for part in pool.map(outcomes, GAITS) for outcome in part]


def run() -> list[Row]:
    """The table's rows."""
    found = measure()
    rows = []
    for tracker in (True, False):
        counts = table(found, tracker)
        where = "tracker" if tracker else "power alone"
        sound = counts.pop(("sound", 0))
        false = sum(n for code, n in sound.items() if code)
        rows.append(
            Row(f"{where}: sound", f"{false} of {sound.total()} runs", "< 1 %", "false alarms")
        )
        for (kind, place), told in counts.items():
            rows.append(_row(where, kind, place, told))
        middle = [o for o in found if o.tracker == tracker and o.size == 1]
        share = sum(right(o) for o in middle) / len(middle)
        goal = ">= 95 %" if tracker else "-"
        rows.append(
            Row(f"{where}: middle sizes", f"{100 * share:.1f} %", goal, "right within two cycles")
        )
    return rows


def _row(where: str, kind: str, place: int, told: Counter[str]) -> Row:
    size = UNITS.get(kind, 1.0) * SIZES[kind][place]
    value = f"{told[CODES[kind]]} of {told.total()}"
    others = ", ".join(
        f"{code or 'nothing'} {n}" for code, n in told.items() if code != CODES[kind]
    )
    best = ""
    if where == "power alone" and kind not in ("robot", "camera"):
        bounds = [bound(gait, kind, place) for gait in GAITS]
        best = f"{100 * sum(bounds) / len(bounds):.0f} %"
    return Row(f"{where}: {kind} {size:g}", value, best or "-", others)


if __name__ == "__main__":
    from benchmarks.report import print_rows

    results = run()
    print_rows(TITLE, results)
