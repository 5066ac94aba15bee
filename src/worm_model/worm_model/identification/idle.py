# SPDX-License-Identifier: Apache-2.0
"""Stage 6: idle power P_idle of each run from its first ten samples (eq:Pidle_est).

The paper's rule requires that the robot rests during these samples. If the sensor is slow or starts with the gait, the
robot moves during some of them. Then only the samples before the onset are used. A run in which fewer than three of
the first ten samples are before the onset has no estimate.

The servo may need power to hold a pretension. The idle power of a run with pretension is used for this run alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from worm_model.identification.data.observed_run import Recording
from worm_model.identification.fits.estimate import Estimate, half_of_mean, quantile

SAMPLES = 10  # number of samples in the paper's rule
FEWEST_SAMPLES = 3  # smallest number of samples at rest
# There is a warning if the mean of the first ten samples differs from the median of all samples at rest by more than
# SETTLED standard errors of the mean, and by more than LEAST_DIFFERENCE times the median.
SETTLED = 5.0
LEAST_DIFFERENCE = 0.02
NO_IDLE = "no run has power samples at rest without pretension: record at least 2 s before the gait starts"
HOLDING = (
    "the idle power includes the power that holds the pretension and is used for this run alone"
)


@dataclass(frozen=True)
class IdlePower:
    """Idle power of a run: ``value`` (W, NaN if unknown) and standard ``deviation`` of the mean (W).

    ``samples`` is the number of samples at rest among the first ten. ``warning`` describes a problem of the
    measurement; empty if there is none. ``holding`` is True if the cable held a pretension.
    """

    value: float
    deviation: float
    samples: int
    warning: str = ""
    holding: bool = False


def idle_power_of(recording: Recording) -> IdlePower:
    """Return the mean of the samples at rest among the run's first ten; NaN if there are fewer than three."""
    first = recording.power[:SAMPLES]
    resting = recording.power_time[:SAMPLES] < 0.0
    count = int(resting.sum())
    if count < FEWEST_SAMPLES:
        return IdlePower(
            np.nan,
            np.nan,
            count,
            f"{recording.name}: {count} of the first ten power samples were measured at rest, so that the run "
            "has no idle power; start the sensor before the gait",
        )
    value = float(first[resting].mean())
    deviation = float(first[resting].std(ddof=1) / np.sqrt(count))
    holding = recording.gait.pretension > 0.0
    remarks = [HOLDING] if holding else []
    later = float(np.median(recording.power[recording.power_time < 0.0]))
    off = abs(value - later)
    if count < SAMPLES:
        remarks.append(
            f"the robot was not at rest in {SAMPLES - count} of the first ten power samples: "
            f"only the {count} samples at rest are used"
        )
    elif off > SETTLED * max(deviation, 1e-6) and off > LEAST_DIFFERENCE * later:
        remarks.append(
            f"the mean of the first ten power samples ({value:.3f} W) differs from the median at rest "
            f"({later:.3f} W): the power was still settling"
        )
    warning = f"{recording.name}: {'; '.join(remarks)}" if remarks else ""
    return IdlePower(value, deviation, count, warning, holding)


def idle_power(runs: Sequence[IdlePower]) -> Estimate | None:
    """Return the mean idle power (W) of the runs without pretension, or None if no such run has an idle power.

    For a single run, the interval follows from the scatter of its samples.
    """
    known = [run for run in runs if np.isfinite(run.value) and not run.holding]
    if not known:
        return None
    values = np.array([run.value for run in known])
    mean = float(values.mean())
    if len(known) > 1:
        half = half_of_mean(values)
    else:
        half = quantile(known[0].samples - 1) * known[0].deviation
    return Estimate(mean, mean - half, mean + half)
