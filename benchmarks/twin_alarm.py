# SPDX-License-Identifier: Apache-2.0
"""The twin's missed-anchor alarm from power alone, over seeded runs of the virtual robot."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.report import Row
from worm_driver.virtual_robot.offline_run import Run, rehearse, sinusoid
from worm_driver.virtual_robot.virtual_settings import load_settings
from worm_model.gait import Gait
from worm_model.parameters import PAPER
from worm_model.twin.core import Twin
from worm_model.twin.hypotheses import FIRST_CYCLE, hypotheses
from worm_model.twin.records import Activity, CommandedLength, GaitSample, PowerSample, Sample

TITLE = "missed-anchor alarm from power alone: detection and false alarms in runs of five cycles"
GAITS = [
    Gait(0.075, 0.2),
    Gait(0.08, 0.15),
    Gait(0.08, 0.2),
    Gait(0.08, 0.3),
    Gait(0.06, 0.3),
    Gait(0.09, 0.1),
    Gait(0.085, 0.25),
    Gait(0.055, 0.1),
]
SEEDS = range(100, 124)  # other ones than those that the alarm's constants come from, 0 to 7
CYCLES = 5
AFTER_S = 1.0  # recorded beyond the end
SCATTER_M = 0.0025  # of the thresholds from groove to groove: rough enough for misses
ZERO_NS = 1_000_000_000_000


@dataclass(frozen=True)
class Counts:
    """Judged cycles that gained fewer grooves than predicted, alarms among them, the others, alarms among those."""

    missed: int = 0
    detected: int = 0
    sound: int = 0
    false: int = 0


def rough_run(gait: Gait, seed: int) -> Run:
    """A run of a robot whose grooves differ."""
    settings = load_settings(None).with_seed(seed)
    settings = replace(settings, effects=replace(settings.effects, threshold_scatter=SCATTER_M))
    wave, end = sinusoid(gait.stroke, gait.frequency), CYCLES * gait.period

    def command(time: float) -> float:
        return wave(time) if time < end else 0.0

    return rehearse(settings, command, end + AFTER_S, direction=gait.direction)


def samples_of(run: Run, gait: Gait) -> list[Sample]:
    """What the twin hears without a camera."""

    def stamp(time: float) -> int:
        return ZERO_NS + round(time * 1e9)

    onset, end = stamp(run.onset), stamp(run.onset + CYCLES * gait.period)
    samples: list[Sample] = [
        GaitSample(stamp(0.1), Activity.RESTING, gait),
        GaitSample(onset, Activity.RUNNING, gait, onset),
        GaitSample(end + 3_000_000, Activity.IDLE),
    ]
    for time in run.servo_time:
        playing = onset < stamp(time) < end
        change = gait.command(time - run.onset) if playing else 0.0
        samples.append(CommandedLength(stamp(time), change))
    for time, power in zip(run.power_time, run.bus_voltage * run.current, strict=True):
        samples.append(PowerSample(stamp(time), float(power)))
    return sorted(samples, key=lambda sample: sample.stamp_ns)


def true_grooves(run: Run, gait: Gait) -> np.ndarray:
    """Grooves that the robot gained in each cycle, by the camera that the twin does not see."""
    seen = np.isfinite(run.rear_position)
    ends = run.onset + np.arange(CYCLES + 1) * gait.period
    x1 = np.interp(ends, run.tracker_time[seen], run.rear_position[seen])
    return np.round(np.diff(x1) / PAPER.pitch).astype(int)


def alarms(run: Run, gait: Gait) -> set[int]:
    """Cycles, 1 the first, in which the twin reports a missed groove."""
    twin = Twin()
    _, output = twin.step(twin.start(), samples_of(run, gait))
    text = "; ".join(notice.text for notice in output.notices)
    return {int(cycle) for cycle in re.findall(r"cycle (\d+): its power", text)}


def count(gait: Gait) -> Counts:
    """The counts of a gait over the seeds."""
    counts = Counts()
    expected = hypotheses(gait, PAPER).grooves
    for seed in SEEDS:
        run = rough_run(gait, seed)
        raised, true = alarms(run, gait), true_grooves(run, gait)
        for cycle in range(FIRST_CYCLE, CYCLES + 1):
            alarm = cycle in raised
            if true[cycle - 1] < expected:
                counts = replace(counts, missed=counts.missed + 1, detected=counts.detected + alarm)
            else:
                counts = replace(counts, sound=counts.sound + 1, false=counts.false + alarm)
    return counts


def row(gait: Gait) -> Row:
    """One gait's line."""
    pair = hypotheses(gait, PAPER)
    what = f"S {gait.stroke:g} m, f {gait.frequency:g} Hz, n = {pair.grooves}"
    if not pair.telling:
        return Row(what, "power cannot tell", "-", f"difference {pair.difference_rms:.3f} W rms")
    c = count(gait)
    value = f"detected {c.detected}/{c.missed}, false {c.false}/{c.sound}"
    how = f"predictions of n and n - 1 differ by {pair.difference_rms:.2f} W rms"
    return Row(what, value, "-", how)


def run() -> list[Row]:
    """Every gait's line."""
    return [row(gait) for gait in GAITS]


if __name__ == "__main__":
    from benchmarks.report import print_rows

    print_rows(TITLE, run())
