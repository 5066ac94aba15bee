# SPDX-License-Identifier: Apache-2.0
"""Speed, power and cost of transport of a recorded gait, of the robot and of a twin alike."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from worm_model.run import GaitStates, Run
from worm_model.simulation.quadrature import accumulated
from worm_model.twin.offline_replay import Replay

STANDARD_GRAVITY = 9.80665  # m/s², as in the cost of transport of the paper
AVERAGED_CYCLES = 3  # the last ones: the paper's protocol

Array = NDArray[np.float64]
Stamps = NDArray[np.int64]


class RecordingError(ValueError):
    """A recording lacks what a comparison needs."""


@dataclass(frozen=True)
class Figures:
    """What one source says of a gait.

    ``speed`` in m/s along +x, ``power`` the mean source power in W, ``cost_of_transport`` 1.
    """

    speed: float
    power: float
    cost_of_transport: float


@dataclass(frozen=True)
class Window:
    """The averaged cycles of a run, from the point of rest before them to the one after, in ns."""

    start: int
    end: int

    @property
    def duration(self) -> float:
        """Seconds."""
        return (self.end - self.start) / 1e9


def averaged_onset(states: GaitStates) -> int:
    """Onset (ns) of the last gait that was run; raises `RecordingError` if none was."""
    return int(states.onset[_last_running(states)])


def averaged_window(states: GaitStates) -> Window:
    """The last three cycles of the last gait that was run; raises `RecordingError` if none was."""
    last = _last_running(states)
    period_ns = 1e9 / states.frequency[last]
    cycles = int(states.cycles[last])
    onset = int(states.onset[last])
    averaged = min(AVERAGED_CYCLES, cycles)
    return Window(
        onset + round((cycles - averaged) * period_ns),
        onset + round(cycles * period_ns),
    )


def _last_running(states: GaitStates) -> int:
    """Row of the last gait that was run."""
    running = np.flatnonzero(states.played)
    if running.size == 0:
        raise RecordingError("the recording has no gait that was run")
    return int(running[-1])


def settled_power(run: Run, replay: Replay) -> tuple[Stamps, Array]:
    """What the twin says of the power (W) at the sensor's stamps."""
    residuals = replay.residuals
    judged = np.isfinite(residuals["power"])
    stamp, residual = residuals["stamp_ns"][judged], residuals["power"][judged]
    samples = run.power
    if not (stamp.size and samples.stamp.size):
        return np.empty(0, np.int64), np.empty(0)
    order = np.argsort(samples.stamp, kind="stable")
    ordered = samples.stamp[order]
    row = np.minimum(np.searchsorted(ordered, stamp), ordered.size - 1)
    same = ordered[row] == stamp
    return stamp[same], samples.valid_power[order][row[same]] - residual[same]


def figures(
    position: tuple[Stamps, Array], energy: tuple[Stamps, Array], mass: float, window: Window
) -> Figures:
    """Figures of a window from samples (stamps, values) of x1 in m and of energy in J.

    Values between samples are interpolated, samples that are NaN are skipped. Raises
    `RecordingError` if the samples do not reach over the window.
    """
    speed = mean_rate(position, window, "position")
    power = mean_rate(energy, window, "energy")
    with np.errstate(divide="ignore"):
        cost = float(np.divide(power, mass * STANDARD_GRAVITY * abs(speed)))
    return Figures(speed, power, cost)


def accumulate(stamps: Stamps, power: Array) -> tuple[Stamps, Array]:
    """Energy (J) at each valid sample of a power (W), by the trapezoidal rule."""
    valid = np.isfinite(power)
    stamps, power = stamps[valid], power[valid]
    return stamps, accumulated((stamps - stamps[:1]).astype(np.float64) * 1e-9, power)


def mean_rate(samples: tuple[Stamps, Array], window: Window, name: str) -> float:
    """Mean rate of change over a window, per s, of samples (stamps, values) that are interpolated.

    Samples that are NaN are skipped. Raises `RecordingError` if the others do not reach over the window.
    """
    stamps, values = samples
    valid = np.isfinite(values)
    stamps, values = stamps[valid], values[valid]
    if stamps.size == 0 or stamps[0] > window.start or stamps[-1] < window.end:
        raise RecordingError(f"the recording has no {name} over the averaged cycles")
    seconds = (stamps - window.start) * 1e-9
    first, last = np.interp([0.0, window.duration], seconds, values)
    return float(last - first) / window.duration
