# SPDX-License-Identifier: Apache-2.0
"""The twin's missed-anchor alarm from power alone, over seeded runs of the virtual robot."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from benchmarks.report import Row
from worm_driver.virtual_robot.offline_run import Run, run_offline, sinusoid
from worm_driver.virtual_robot.virtual_settings import load_settings
from worm_model.gait import Gait
from worm_model.parameters import PAPER
from worm_model.run import GaitStates, LengthSamples, PowerSamples
from worm_model.run import Run as Recording
from worm_model.twin.hypotheses import FIRST_CYCLE, hypotheses
from worm_model.twin.offline_replay import replay_run
from worm_model.twin.records import Activity

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

    return run_offline(settings, command, end + AFTER_S, direction=gait.direction)


def recording_of(run: Run, gait: Gait) -> Recording:
    """What the twin hears without a camera."""

    def stamp(time: np.ndarray | float) -> np.ndarray:
        return ZERO_NS + np.rint(np.asarray(time) * 1e9).astype(np.int64)

    told = stamp(np.array([0.1, run.onset, run.onset + CYCLES * gait.period + 0.003]))
    one = np.ones(3)
    since = np.asarray(run.servo_time) - run.onset
    playing = (since > 0.0) & (since < CYCLES * gait.period)
    change = np.where(playing, [gait.command(time) for time in since.tolist()], 0.0)
    power, none = np.asarray(run.bus_voltage) * np.asarray(run.current), 0 * run.power_time
    return Recording(
        origin=ZERO_NS,
        commanded=LengthSamples(stamp(run.servo_time), PAPER.initial_length + change, change),
        power=PowerSamples(stamp(run.power_time), none.astype(np.int64), none, none, power),
        gait_state=GaitStates(
            stamp=told,
            state=np.array([Activity.RESTING, Activity.RUNNING, Activity.IDLE]),
            stroke=gait.stroke * one,
            frequency=gait.frequency * one,
            direction=np.full(3, gait.direction),
            margin=gait.margin * one,
            onset=np.array([0, told[1], told[1]]),
        ),
    )


def true_grooves(run: Run, gait: Gait) -> np.ndarray:
    """Grooves that the robot gained in each cycle, by the camera that the twin does not see."""
    seen = np.isfinite(run.rear_position)
    ends = run.onset + np.arange(CYCLES + 1) * gait.period
    x1 = np.interp(ends, run.tracker_time[seen], run.rear_position[seen])
    return np.round(np.diff(x1) / PAPER.pitch).astype(int)


def alarms(run: Run, gait: Gait) -> set[int]:
    """Cycles, 1 the first, in which the twin reports a missed groove."""
    notices = replay_run(recording_of(run, gait), PAPER).notices
    return {notice.cycle for notice in notices if notice.code == "missed_groove"}


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
