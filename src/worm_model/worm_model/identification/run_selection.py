# SPDX-License-Identifier: Apache-2.0
"""The runs that identification uses, those that it is checked against, and what was seen in both."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from worm_model.identification.estimate import Estimate, half_of_mean, quantile
from worm_model.identification.identification_errors import IdentificationError
from worm_model.identification.idle import IdlePower, idle_power_of
from worm_model.identification.locomotion import Traverse, traverse_of
from worm_model.identification.measured_length import MeasuredLength, measured_length
from worm_model.identification.observed_run import Recording
from worm_model.identification.quality import power_missing, remarks, starts_apart, usable

OF_THE_MEAN = "of the mean; runs scatter around it by {:.3f} mm (standard deviation)"
ONE_RUN = "as the camera saw this one run; how much runs differ is not known"


@dataclass(frozen=True)
class Run:
    """A run that was used: its recording, smoothed length, five ridges and idle power.

    ``powered``: whether its power was seen over the five ridges, so that it bears on c_b and α_P.
    """

    recording: Recording
    length: MeasuredLength
    traverse: Traverse
    idle: IdlePower
    powered: bool

    @property
    def name(self) -> str:
        """The run's name."""
        return self.recording.name


def prepared(recordings: Sequence[Recording], pitch: float) -> tuple[list[Run], list[str]]:
    """(the runs that can be used, what was seen in all of them).

    Raises `IdentificationError` if none can be used.
    """
    lengths = [measured_length(recording) for recording in recordings]
    kept, warnings = usable(recordings, lengths)
    runs = []
    for index in kept:
        recording, length = recordings[index], lengths[index]
        traverse = traverse_of(recording, length, pitch)
        missing = power_missing(recording, traverse)
        run = Run(recording, length, traverse, idle_power_of(recording), not missing)
        warnings += remarks(recording, length, traverse)
        warnings += [text for text in (missing, run.idle.warning) if text]
        runs.append(run)
    return runs, warnings


def fitted_runs(recordings: Sequence[Recording], pitch: float) -> tuple[list[Run], list[str]]:
    """`prepared` runs, which all begin in the same grooves, or it is said.

    Raises `IdentificationError` if none can be used.
    """
    runs, warnings = prepared(recordings, pitch)
    warnings += starts_apart([run.recording for run in runs])
    return runs, warnings


def prepared_validation(
    recordings: Sequence[Recording], fitted: Sequence[Recording], pitch: float
) -> tuple[list[Run], list[str]]:
    """The same of runs that were kept aside, which none of the fitted ones may be.

    Raises `IdentificationError` if one was fitted too, is named twice, or if none can be used.
    """
    known = {_identity(recording): recording.name for recording in fitted}
    names: set[str] = set()
    for recording in recordings:
        if _identity(recording) in known:
            raise IdentificationError(
                f"validation run {recording.name} is {known[_identity(recording)]}, which is fitted too: a run can "
                "check only what it did not shape"
            )
        if recording.name in names:
            raise IdentificationError(
                f"two validation runs are called {recording.name}: name it once, or rename one of them"
            )
        names.add(recording.name)
    if not recordings:
        return [], []
    runs, warnings = prepared(recordings, pitch)
    return runs, [f"validation: {text}" for text in warnings]


def _identity(recording: Recording) -> tuple[str, ...]:
    """By the contents of its files, by its name where there are none."""
    return tuple(sorted(recording.sources.values())) or (recording.name,)


def initial_length(runs: Sequence[Run]) -> Estimate:
    """The mean over runs, with the interval of that mean; how far a run is from it is for the caller to tell too."""
    lengths = np.array([run.length.initial_length for run in runs])
    mean = float(lengths.mean())
    if lengths.size == 1:
        half = quantile(np.inf) * runs[0].length.initial_spread
        return Estimate(mean, mean - half, mean + half, True, ONE_RUN)
    half, note = half_of_mean(lengths), OF_THE_MEAN.format(float(lengths.std(ddof=1)) * 1e3)
    return Estimate(mean, mean - half, mean + half, True, note)
