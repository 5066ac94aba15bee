# SPDX-License-Identifier: Apache-2.0
"""Plausibility check of the pitch from x1: a robot advances by whole grooves per cycle.

After one period, the rear module has the same position in its groove again, so that it has advanced by n·d. The check
detects a wrong given pitch. Such a pitch would bias all other estimates: the front fin starts L0/d ≈ 17 grooves ahead
of the rear fin, so that its start would be wrong by 17 times the error.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from worm_model.errors import IdentificationError
from worm_model.identification.data.observed_run import Recording

# Largest deviation of a stride from whole grooves, in pitches per groove. If it is larger, a fin was slipping at the
# beginning or at the end of the stride.
SLIPPING = 0.15
FEWEST = 20  # smallest number of strides
RIDGES = 5  # number of ridges that the runs pass
# Largest difference between the given pitch and that of the strides, relative to the pitch. It is three times the error
# of strides on a robot with varying grooves.
TOLERANCE = 0.008


def pitch_of_strides(recording: Recording, pitch: float) -> float:
    """Return the pitch (m) that follows from a run's strides; NaN if there are too few strides.

    ``pitch`` is an approximate value of the pitch in m. It determines the number of grooves of each stride.
    """
    _, grooves, strides = _strides(recording, pitch)
    return float(np.median(strides / grooves)) if strides.size >= FEWEST else float("nan")


def uneven_pitch(recordings: Sequence[Recording], pitch: float) -> float:
    """Return the standard deviation (m) of the pitch from groove to groove; 0 if the runs do not show it.

    It follows from the strides of the cycles of each run. A stride of n grooves is the sum of n pitches.
    """
    squares, freedom = 0.0, 0
    for recording in recordings:
        time, grooves, strides = _strides(recording, pitch)
        cycles = np.floor(time * recording.gait.frequency)
        of_cycle = [
            np.median((strides / np.sqrt(grooves) - np.sqrt(grooves) * pitch)[cycles == cycle])
            for cycle in np.unique(cycles)
        ]
        if len(of_cycle) > 1:
            squares += float(np.var(of_cycle)) * len(of_cycle)
            freedom += len(of_cycle) - 1
    return float(np.sqrt(squares / freedom)) if freedom else 0.0


def _strides(
    recording: Recording, pitch: float
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return begins (s), grooves and lengths (m) of the strides of whole grooves, each of shape (n,).

    A stride is the advance over the period after a camera sample. The first and the last cycle are left out.
    """
    known = np.isfinite(recording.x1)
    time, x1 = recording.camera_time[known], recording.gait.direction * recording.x1[known]
    period = recording.gait.period
    begins = (time > period) & (time < min(recording.end, time[-1]) - period)
    strides = np.interp(time[begins] + period, time, x1) - x1[begins]
    grooves = np.round(strides / pitch)
    whole = (grooves >= 1) & (np.abs(strides - grooves * pitch) < SLIPPING * pitch * grooves)
    return time[begins][whole], grooves[whole], strides[whole]


def check_pitch(recordings: Sequence[Recording], pitch: float, deviation: float = 0.0) -> None:
    """Check a given pitch (m, with standard ``deviation``) against the strides of all runs.

    In a pipe with an uneven pitch, the ridges that the runs pass may differ from the pipe's mean.
    """
    pitches = np.array([pitch_of_strides(recording, pitch) for recording in recordings])
    pitches = pitches[np.isfinite(pitches)]
    if not pitches.size:
        return
    median = float(np.median(pitches))
    of_ridges = uneven_pitch(recordings, median) / np.sqrt(RIDGES)
    if abs(median - pitch) > TOLERANCE * pitch + 3.0 * np.hypot(deviation, of_ridges):
        raise IdentificationError(
            f"pitch: given as {1e3 * pitch:.2f} mm, but the rear module gains {1e3 * median:.2f} mm per groove. "
            "Measure the pitch again, and check the camera's scale; all other estimates depend on the pitch"
        )
