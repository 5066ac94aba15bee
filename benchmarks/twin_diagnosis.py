# SPDX-License-Identifier: Apache-2.0
"""Diagnosis of robots with a fault: reported and true cause, over seeded runs.

`tests/helpers/faulty_robots.py` integrates the robots in steps. Their parameters differ from the twin's. They have dry
friction, uneven grooves and noisy instruments. Each fault begins in the second to the fourth of five cycles. The bound
for power alone is the detection rate on cycles that are drawn from the twin's own likelihood. Further healthy robots
run at eight groove phases, near edges of the grooves per cycle, and with a compliant cable.
``python -m benchmarks.twin_diagnosis FOLDER`` also draws the figures.
"""

from __future__ import annotations

import math
import os
import sys
from collections import Counter
from collections.abc import Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray

from benchmarks.report import Row, print_rows
from tests.helpers.faulty_robots import ONSET, Fault, Lab, run_robots
from tests.helpers.virtual_campaign import REST, run_of
from worm_driver.virtual_robot.offline_run import run_offline
from worm_driver.virtual_robot.virtual_settings import load_settings
from worm_model.gait import Gait
from worm_model.parameters import PAPER, Parameters
from worm_model.run import LengthSamples, TrackerSamples
from worm_model.simulation.batch import evaluate_gaits
from worm_model.simulation.simulator import evaluate_gait
from worm_model.twin.cause_table import EVENT_CODES, GAINED, LASTING, MISSED_BY_FIN, Cause
from worm_model.twin.causes import SCATTER, Candidate, Data, weigh_causes
from worm_model.twin.core.memory import CHANNELS, POWER
from worm_model.twin.cycle_data import FIRST, POWER_SHARE, CycleData
from worm_model.twin.data.records import Event, Health, Severity
from worm_model.twin.diagnosis import History, judge_causes
from worm_model.twin.offline_replay import replay_run
from worm_model.twin.signatures import BINS, Signatures, signatures
from worm_model.twin.twin import Twin

TITLE = "diagnosis of the twin: causes named within two cycles, and false alarms, in runs of five cycles (minutes)"
GAITS = (Gait(0.08, 0.2), Gait(0.06, 0.3), Gait(0.085, 0.25))
CYCLES = 5
REPEATS = 4  # of each fault and size with each gait
SOUND = 60  # runs with each gait
DRAWS = 3  # from the likelihood for each run
SEED = 11
PHASES_M = (-0.0075, -0.0051, -0.001, 0.0011, 0.002, 0.0035, 0.0055, 0.008)  # groove phases
CLIFF_M = -0.003  # groove phase at which the front fin is at its edge with every stroke
AT_PHASE = 8  # healthy robots at each phase, with each gait and kind of instruments
FROM_EDGE_M = (0.0002, 0.0005, 0.001, 0.002)  # distances of the stroke from an edge
AT_EDGE = 4  # healthy robots at each phase, distance, side and kind of instruments
CABLE_N_PER_M = 6400.0  # stiffness of the compliant cable
TRACKER, ALONE, BOUND = "tracker", "power alone", "likelihood of power"
IN_TIME = (
    1.05  # cycles after the end of that of the fault by which a cause is named within two cycles
)
MIDDLE = 1


@dataclass(frozen=True)
class FaultKind:
    """Kind of a fault.

    Attributes:
        name: label with the unit.
        sizes: small, middle and large size, relative or in the SI unit.
        code: the right code of TwinEvent.
        scale: factor from the size to the unit of the label.
        fault: kind in tests/helpers/faulty_robots.py.
    """

    name: str
    sizes: tuple[float, float, float]
    code: str
    scale: float
    fault: str


def _kinds_of(cause: Cause) -> dict[str, FaultKind]:
    """Return a kind for each three sizes of a lasting cause."""
    kinds = {}
    for sizes in cause.trials:
        code = cause.code(sizes[0]).code
        way = "up" if sizes[0] > 0.0 else "down"
        key = cause.name if cause.up == cause.down else f"{cause.name} {way}"
        label = f"{key.replace('_', ' ')} ({cause.unit})"
        kinds[key] = FaultKind(label, sizes, code, cause.scale, cause.name)
    return kinds


KINDS = {
    "rear": FaultKind(
        "rear fin misses its last groove (number of successive cycles)",
        (1, 2, 3),
        "missed_groove_rear",
        1.0,
        "rear",
    ),
    "front": FaultKind(
        "front fin misses its last groove (number of successive cycles)",
        (1, 2, 3),
        "missed_groove_front",
        1.0,
        "front",
    ),
    "gained": FaultKind("groove gained", (1, 1, 1), "gained_groove", 1.0, "gained"),
    **{key: kind for cause in LASTING.values() for key, kind in _kinds_of(cause).items()},
    "robot": FaultKind("robot moved (grooves)", (1, 3, 5), "robot_moved", 1.0, "robot"),
    "camera": FaultKind("camera moved (mm)", (0.004, 0.012, 0.040), "camera_moved", 1e3, "camera"),
}
UNSEEN = ("robot", "camera")  # by power
CODES = ("", *(row.code for row in EVENT_CODES))


@dataclass(frozen=True)
class Outcome:
    """Outcome of a run.

    Attributes:
        gait: index of the gait.
        kind: kind of the fault.
        size: index of its size, 0 to 2.
        seen_by: instruments.
        reported: code of the first reported cause; empty if none was reported.
        late: cycles from the end of the cycle of the fault to the report.
    """

    gait: int
    kind: str
    size: int
    seen_by: str
    reported: str = ""
    late: float = math.nan

    @property
    def right(self) -> bool:
        """True if the cause was reported, and in time."""
        if self.kind == "healthy":
            return not self.reported
        return self.reported == KINDS[self.kind].code and self.late <= IN_TIME


def faults() -> list[tuple[str, int, Fault]]:
    """Return (kind, index of the size, fault) of all runs with a gait; a fault of a fin lasts whole cycles."""
    found = [("healthy", 0, Fault()) for _ in range(SOUND)]
    for kind, about in KINDS.items():
        for place, size in enumerate(about.sizes):
            for k in range(REPEATS):
                whole = kind in ("rear", "front", "gained")
                phase = 0.0 if whole else 0.3 * ((k + place) % 3)
                found.append((kind, place, Fault(about.fault, size, 2 + k % 3, phase)))
    return found


# --- robots ---------------------------------------------------------------------------------------------


def followed(gait: int, seen_by: str) -> list[Outcome]:
    """Return the outcomes of the twin for all runs with a gait."""
    played, wanted = GAITS[gait], faults()
    usual = round(evaluate_gait(played).grooves_per_cycle)
    robots = run_robots(played, [f for _, _, f in wanted], seed=SEED, usual=usual)
    found = []
    for k, (kind, place, fault) in enumerate(wanted):
        twin = Twin()
        rows = robots.rows(k, tracker=seen_by == TRACKER)
        events = twin.advance(twin.start(), rows, to_the_end=True).events
        outcome = Outcome(gait, kind, place, seen_by)
        coded = next((event for event in events if event.severity > Severity.INFO), None)
        if coded is not None:
            late = (coded.stamp_ns - ONSET) * 1e-9 / played.period - fault.cycle
            outcome = replace(outcome, reported=coded.code, late=late)
        found.append(outcome)
    return found


# --- healthy robots at other groove phases, near edges, and with a compliant cable -----------------------


@dataclass(frozen=True)
class Healthy:
    """Run of a healthy robot.

    Attributes:
        where: label of the row.
        seen_by: instruments.
        alarms: codes of the reported causes.
        faulty: True if the health was FAULTY at any time.
    """

    where: str
    seen_by: str
    alarms: tuple[str, ...]
    faulty: bool


def at_phase(phase: float) -> list[Healthy]:
    """Return runs of healthy robots with a groove phase (m), far from and near edges, and with a compliant cable."""
    count = round((PAPER.initial_length - phase) / PAPER.pitch)
    parameters = PAPER.replace(initial_length=count * PAPER.pitch + phase)
    where = "front fin at its edge" if phase == CLIFF_M else "away from edges"
    found = [
        run
        for usual in GAITS
        for run in _healthy(where, _far(usual, parameters), parameters, AT_PHASE)
    ]
    edge = _edges(GAITS[0], parameters)[-1]
    for distance in FROM_EDGE_M:
        for stroke in (edge - distance, edge + distance):
            gait = replace(GAITS[0], stroke=stroke)
            found += _healthy(f"{1e3 * distance:g} mm from an edge", gait, parameters, AT_EDGE)
    return found + _compliant(_far(GAITS[0], parameters), parameters)


def _edges(gait: Gait, parameters: Parameters) -> np.ndarray:
    """Return the strokes (m) at which a gait begins to gain another number of grooves."""
    strokes = np.arange(0.05, 0.09, 5e-5)
    table = evaluate_gaits(strokes, gait.frequency, parameters=parameters)
    return strokes[1:][np.diff(np.round(table.min_grooves)) != 0.0]


def _far(gait: Gait, parameters: Parameters) -> Gait:
    """Return the gait with the nearest stroke that is at least 3 mm from all edges and gains a groove."""
    edges, strokes = _edges(gait, parameters), np.arange(0.05, 0.09, 5e-4)
    far = np.abs(strokes[:, None] - edges).min(axis=1) > 3e-3
    table = evaluate_gaits(strokes, gait.frequency, parameters=parameters)
    fit = strokes[far & (np.round(table.min_grooves) > 0.0)]
    return replace(gait, stroke=float(fit[np.argmin(np.abs(fit - gait.stroke))]))


def _healthy(where: str, gait: Gait, parameters: Parameters, count: int) -> list[Healthy]:
    robots = run_robots(gait, [Fault()] * count, seed=SEED, truth=parameters)
    twin, found = Twin(parameters), []
    for seen_by in (TRACKER, ALONE):
        for k in range(count):
            rows = robots.rows(k, tracker=seen_by == TRACKER)
            output = twin.advance(twin.start(), rows, to_the_end=True)
            found.append(_judged(where, seen_by, output.events, output.residuals["health"]))
    return found


def _judged(
    where: str, seen_by: str, events: Iterable[Event], health: NDArray[np.int64]
) -> Healthy:
    alarms = tuple(event.code for event in events if event.severity > Severity.INFO)
    return Healthy(where, seen_by, alarms, bool(np.any(health == Health.FAULTY)))


def _compliant(gait: Gait, parameters: Parameters) -> list[Healthy]:
    """Return the runs of the virtual robot with a compliant cable."""
    robot = load_settings()
    settings = replace(
        robot,
        effects=replace(robot.effects, cable_stiffness=CABLE_N_PER_M),
        body=replace(robot.body, initial_length=parameters.initial_length),
    )
    rehearsal = run_offline(settings, gait.length_change, (CYCLES + 0.1) * gait.period, REST)
    tracked = run_of(rehearsal, gait, settings)
    found = []
    for seen_by, run in (
        (TRACKER, tracked),
        (ALONE, replace(tracked, tracker=TrackerSamples(), measured=LengthSamples())),
    ):
        replay = replay_run(run, parameters)
        health = replay.residuals["health"]
        found.append(_judged("compliant cable", seen_by, replay.notices, health))
    return found


def healthy_rows(found: Sequence[Healthy]) -> list[Row]:
    """Return the rows of the table about healthy robots at all phases."""
    table = []
    for where in dict.fromkeys(run.where for run in found):
        for seen_by in (TRACKER, ALONE):
            mine = [r for r in found if (r.where, r.seen_by) == (where, seen_by)]
            alarmed = [r for r in mine if r.alarms]
            codes = Counter(code for r in alarmed for code in r.alarms)
            faulty = sum(r.faulty for r in mine)
            goal = "<= 5 % FAULTY" if "from an edge" in where else "no alarm"
            text = f"{len(alarmed)} of {len(mine)} with an alarm, {faulty} FAULTY"
            names = ", ".join(f"{code} {n}" for code, n in codes.items())
            table.append(Row(f"{seen_by}: healthy, {where}", text, goal, names))
    return table


# --- what the likelihood allows -------------------------------------------------------------------------


def drawn(gait: int) -> list[Outcome]:
    """Return the outcomes of runs that are drawn from the twin's likelihood, for the faults that power can show."""
    draw = np.random.default_rng(SEED)
    signs = signatures(GAITS[gait], PAPER, driven=False)
    return [
        _drawn(Outcome(gait, kind, place, BOUND), fault, signs, draw)
        for kind, place, fault in DRAWS * faults()
        if kind not in UNSEEN
    ]


def _drawn(outcome: Outcome, fault: Fault, signs: Signatures, draw: np.random.Generator) -> Outcome:
    blank = [_cycle(number, signs) for number in range(1, CYCLES + 1)]
    data = Data(blank, (), signs)
    cause = _cause(fault, signs)
    if cause is None:
        return outcome
    what, size = cause
    values = data.nuisances @ draw.normal(size=data.nuisances.shape[-1])
    values += data.offsets * draw.normal(size=data.offsets.shape)
    values += 0.0 if what is None else size * data.direction(what)
    some = data.weight > 0.0
    values[some] += draw.normal(size=int(some.sum())) / np.sqrt(data.weight[some])
    seen = np.where(some, values, 0.0).reshape(CYCLES, CHANNELS, BINS)
    history = History()
    for cycle, value in zip(blank, seen, strict=True):
        history = replace(history, cycles=(*history.cycles, replace(cycle, values=value)))
        weighed = weigh_causes(history.cycles, history.reported, signs, length_seen=False)
        history, findings = judge_causes(history, cycle.number, weighed)
        if findings:
            return replace(
                outcome, reported=findings[0].code.code, late=float(cycle.number - fault.cycle)
            )
    return outcome


def _cycle(number: int, signs: Signatures) -> CycleData:
    """Return a cycle in which only the power is known, with the noise of the robots' sensor."""
    lab = Lab()
    scatter = (SCATTER[POWER] + POWER_SHARE * signs.power) * (FIRST[POWER] if number == 1 else 1.0)
    variance = np.full((CHANNELS, BINS), np.inf)
    variance[POWER] = scatter**2 + lab.power_noise_W**2 / 20.0
    return CycleData(number, np.zeros((CHANNELS, BINS)), variance, None)


def _cause(fault: Fault, signs: Signatures) -> tuple[Candidate | None, float] | None:
    """Return (cause, size in usual sizes) of a fault; None if the gait does not have that groove."""
    if fault.kind == "healthy":
        return None, 0.0
    if fault.kind in MISSED_BY_FIN:
        known = fault.kind in signs.missed
        cause = Candidate(
            MISSED_BY_FIN[fault.kind], fault.kind, fault.cycle, 0.0, cycles=int(fault.size)
        )
        return (cause, 1.0) if known else None
    if fault.kind == "gained":
        how = next((name for name in signs.gained if name.startswith("rear")), "")
        return None if not how else (Candidate(GAINED, how, fault.cycle, 0.0, cycles=1), 1.0)
    row = LASTING[fault.kind]
    candidate = Candidate(row.up, row.name, fault.cycle, 0.0, fault.phase)
    return candidate, fault.size / row.size


# --- all of it ------------------------------------------------------------------------------------------


def measure() -> list[Outcome]:
    """Return all outcomes, computed on all cores."""
    found: list[Outcome] = []
    with ProcessPoolExecutor(os.cpu_count(), get_context("spawn")) as pool:
        jobs = [
            pool.submit(followed, gait, seen_by)
            for gait in range(len(GAITS))
            for seen_by in (TRACKER, ALONE)
        ]
        jobs += [pool.submit(drawn, gait) for gait in range(len(GAITS))]
        for number, job in enumerate(jobs, 1):
            found += job.result()
            print(f"  {number} of {len(jobs)} parts", file=sys.stderr, flush=True)
    return found


def share(outcomes: Iterable[Outcome]) -> float:
    """Return the share of right outcomes; NaN for none."""
    right = [outcome.right for outcome in outcomes]
    return sum(right) / len(right) if right else math.nan


def rows(found: Sequence[Outcome]) -> list[Row]:
    """Return the rows of the table."""
    table = []
    for seen_by in (TRACKER, ALONE, BOUND):
        mine = [o for o in found if o.seen_by == seen_by]
        sound = [o for o in mine if o.kind == "healthy"]
        false = sum(bool(o.reported) for o in sound)
        table.append(Row(f"{seen_by}: sound", f"{false} of {len(sound)}", "< 1 %", "false alarms"))
        for kind in KINDS if seen_by == TRACKER else (k for k in KINDS if k not in UNSEEN):
            for place in range(3):
                table.append(_row(seen_by, kind, place, mine))
        middle = [
            o for o in mine if o.size == MIDDLE and (seen_by == TRACKER or o.kind not in UNSEEN)
        ]
        goal = {TRACKER: ">= 95 %", ALONE: f"{100 * _middle(found, BOUND):.1f} %"}.get(seen_by, "-")
        table.append(
            Row(f"{seen_by}: middle sizes", f"{100 * share(middle):.1f} %", goal, "named in time")
        )
        for fin in ("rear", "front"):
            for place, gait in enumerate(GAITS):
                of_fin = [o for o in mine if o.kind == fin and o.gait == place]
                what = f"{seen_by}: {fin} fin, {1e3 * gait.stroke:g} mm at {gait.frequency:g} Hz"
                table.append(Row(what, f"{100 * share(of_fin):.0f} %", "-", f"of {len(of_fin)}"))
    return table


def _middle(found: Sequence[Outcome], seen_by: str) -> float:
    return share(
        o for o in found if o.seen_by == seen_by and o.size == MIDDLE and o.kind not in UNSEEN
    )


def _row(seen_by: str, kind: str, place: int, mine: Sequence[Outcome]) -> Row:
    about = KINDS[kind]
    cell = [o for o in mine if (o.kind, o.size) == (kind, place)]
    others = Counter(_said(o) for o in cell if not o.right)
    return Row(
        f"{seen_by}: {kind} {about.scale * about.sizes[place]:g}",
        f"{sum(o.right for o in cell)} of {len(cell)}",
        "-",
        ", ".join(f"{what} {n}" for what, n in others.items()),
    )


def _said(outcome: Outcome) -> str:
    if not outcome.reported:
        return "nothing"
    late = "" if outcome.late <= IN_TIME else " too late"
    return f"{outcome.reported}{late}"


def measure_healthy() -> list[Healthy]:
    """Return the runs of healthy robots at all phases, computed on all cores."""
    with ProcessPoolExecutor(os.cpu_count(), get_context("spawn")) as pool:
        return [run for part in pool.map(at_phase, (*PHASES_M, CLIFF_M)) for run in part]


def run() -> list[Row]:
    """Return the rows of the table."""
    return rows(measure()) + healthy_rows(measure_healthy())


# --- figures --------------------------------------------------------------------------------------------


def draw_confusion(found: Sequence[Outcome], path: Path) -> None:
    """Draw the reported causes for each cause of the middle size, with a tracker and from power alone."""
    kinds = ["healthy", *KINDS]
    figure, axes = plt.subplots(1, 2, figsize=(13, 6), sharey=True, layout="constrained")
    for axis, seen_by in zip(axes, (TRACKER, ALONE), strict=True):
        counts = np.zeros((len(kinds), len(CODES)))
        for o in found:
            if o.seen_by == seen_by and (o.size == MIDDLE or o.kind == "healthy"):
                counts[kinds.index(o.kind), CODES.index(o.reported)] += 1
        shares = 100.0 * counts / counts.sum(axis=1, keepdims=True)
        axis.imshow(shares, cmap="Blues", vmin=0.0, vmax=130.0, aspect="auto")
        for row, column in np.argwhere(counts > 0):
            colour = "white" if shares[row, column] > 75 else "black"
            text = f"{counts[row, column]:.0f}"
            axis.text(column, row, text, ha="center", va="center", color=colour)
        names = [code.replace("_", " ") or "nothing" for code in CODES]
        axis.set_xticks(range(len(CODES)), names, rotation=45, ha="right")
        axis.set_xlabel("first cause reported by the twin")
        axis.set_title(f"with a {seen_by}" if seen_by == TRACKER else seen_by)
    axes[0].set_yticks(range(len(kinds)), ["healthy", *map(_with_size, KINDS)])
    axes[0].set_ylabel("simulated cause, at the middle size")
    figure.savefig(path, dpi=110)
    plt.close(figure)


def _with_size(kind: str) -> str:
    about = KINDS[kind]
    return f"{about.name}: {about.scale * about.sizes[MIDDLE]:g}"


def draw_detection(found: Sequence[Outcome], path: Path) -> None:
    """Draw the detection rate of each cause over its size: within two cycles, and with a tracker within one."""
    lines = math.ceil((len(KINDS) + 1) / 4)  # the last place has the legend
    size = (12, 2.7 * lines)
    figure, axes = plt.subplots(lines, 4, figsize=size, sharey=True, layout="constrained")
    for axis, (kind, about) in zip(axes.flat, KINDS.items(), strict=False):
        for seen_by, style in ((TRACKER, "o-"), (ALONE, "s-"), (BOUND, "k:")):
            if seen_by != BOUND or kind not in UNSEEN:
                axis.plot(range(3), _rates(found, kind, seen_by, IN_TIME), style, label=seen_by)
        axis.plot(range(3), _rates(found, kind, TRACKER, IN_TIME - 1.0), "C0--", alpha=0.6)
        axis.set_xticks(range(3), [f"{about.scale * size:g}" for size in about.sizes])
        axis.set_ylim(-5, 105)
        axis.grid(alpha=0.3)
        axis.set_title(about.name, fontsize=10)
    for axis in axes[:, 0]:
        axis.set_ylabel("named (%)")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    (once,) = axes.flat[-1].plot([], [], "C0--", alpha=0.6)
    axes.flat[-1].axis("off")
    axes.flat[-1].legend(
        [*handles, once],
        [*(f"{x}, two cycles" for x in labels), "tracker, one cycle"],
        loc="center",
    )
    figure.savefig(path, dpi=110)
    plt.close(figure)


def _rates(found: Sequence[Outcome], kind: str, seen_by: str, in_time: float) -> list[float]:
    """Return the detection rate in per cent within a time (cycles), by size."""
    cells = [
        [o for o in found if (o.kind, o.size, o.seen_by) == (kind, p, seen_by)] for p in range(3)
    ]
    return [100.0 * sum(o.right and o.late <= in_time for o in cell) / len(cell) for cell in cells]


if __name__ == "__main__":
    outcomes = measure()
    print_rows(TITLE, rows(outcomes) + healthy_rows(measure_healthy()))
    folder = Path(sys.argv[1])
    draw_confusion(outcomes, folder / "twin_diagnosis.png")
    draw_detection(outcomes, folder / "twin_detection.png")
