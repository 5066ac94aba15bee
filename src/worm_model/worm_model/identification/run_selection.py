# SPDX-License-Identifier: Apache-2.0
"""Selection of the runs for fitting, with remarks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from worm_model.identification.data.observed_run import Recording
from worm_model.identification.fits.estimate import Estimate, half_of_mean, quantile
from worm_model.identification.fits.locomotion import Traverse, traverse_of
from worm_model.identification.fits.measured_length import MeasuredLength, measured_length
from worm_model.identification.fits.quality import power_missing, remarks, starts_apart, usable
from worm_model.identification.idle import IdlePower, idle_power_of

OF_THE_MEAN = "interval of the mean; the standard deviation between runs is {:.3f} mm"
ONE_RUN = "measured in this single run; the variation between runs is unknown"


@dataclass(frozen=True)
class FittedRun:
    """Run used for fitting: recording, traverse with the smoothed length, and idle power.

    ``has_power`` is True if power samples cover the traverse, so that the run is used for c_b and α_P.
    """

    recording: Recording
    traverse: Traverse
    idle: IdlePower
    has_power: bool

    @property
    def name(self) -> str:
        """Name of the run."""
        return self.recording.name

    @property
    def length(self) -> MeasuredLength:
        """Smoothed length of the body."""
        return self.traverse.length


def fitted_runs(recordings: Sequence[Recording], pitch: float) -> tuple[list[FittedRun], list[str]]:
    """Return the usable runs and the remarks on all runs, with a warning if they start in different grooves."""
    lengths = [measured_length(recording) for recording in recordings]
    kept, warnings = usable(recordings, lengths)
    runs = []
    for index in kept:
        recording, length = recordings[index], lengths[index]
        traverse = traverse_of(recording, length, pitch)
        missing = power_missing(recording, traverse)
        run = FittedRun(recording, traverse, idle_power_of(recording), not missing)
        warnings += remarks(recording, length, traverse)
        warnings += [text for text in (missing, run.idle.warning) if text]
        runs.append(run)
    return runs, warnings + starts_apart([run.recording for run in runs])


def initial_length(runs: Sequence[FittedRun]) -> Estimate:
    """Return the mean L0 over runs with its interval; the note contains the variation between runs."""
    lengths = np.array([run.length.initial_length for run in runs])
    mean = float(lengths.mean())
    if lengths.size == 1:
        half = quantile(np.inf) * runs[0].length.initial_spread
        return Estimate(mean, mean - half, mean + half, True, ONE_RUN)
    half, note = half_of_mean(lengths), OF_THE_MEAN.format(float(lengths.std(ddof=1)) * 1e3)
    return Estimate(mean, mean - half, mean + half, True, note)
