# SPDX-License-Identifier: Apache-2.0
"""Fit of the actuation model to the contractions alone, and the length that the body lacks in its extensions.

A taut cable determines the length in a contraction. A cable that cannot push leaves the extension to the bellows, which
lag behind in fast gaits. The contractions then follow the model, and the extensions end too short.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from worm_model.arrays import Array
from worm_model.identification.data.observed_run import Recording
from worm_model.identification.fits.actuation_fit import (
    CLOCK,
    START,
    actuation_problem,
    fitted_samples,
    slack_length,
)
from worm_model.identification.fits.block_least_squares import solve
from worm_model.identification.fits.robust import noise_of

# Share of a contraction after which the cable is taut, and of an extension after which the bellows may lag behind
TAUT, LATE = 0.3, 0.5


@dataclass(frozen=True)
class ContractionFit:
    """Clock offset of each run in s (see `ActuationFit.clock_offset`), and the lacking length of each run in m.

    The lacking length is the median of predicted minus measured length in the second halves of the extensions.
    """

    clock_offset: Array
    lacking: Array


def fit_contractions(recordings: Sequence[Recording]) -> ContractionFit:
    """Fit the actuation model to the rest and to the contractions of all recordings."""
    phases = [_phases(recording) for recording in recordings]
    weights = [
        np.where((time < 0.0) | ((part > TAUT) & (part < 1.0)), 1.0, 0.0) for time, part in phases
    ]
    own = np.array([[slack_length(r), 0.0, 0.0] for r in recordings])
    problem = actuation_problem(recordings)
    solution = solve(problem, np.array(START), own, weights)
    lacking = [
        -noise_of(recording.length) * _median(residuals[(time > 0.0) & (part > 1.0 + LATE)])
        for recording, residuals, (time, part) in zip(
            recordings, solution.residuals, phases, strict=True
        )
    ]
    return ContractionFit(solution.own[:, CLOCK], np.array(lacking))


def _phases(recording: Recording) -> tuple[Array, Array]:
    """Return the times (n,) in s of the fitted samples and their parts of the cycle (n,).

    The part is 0 to 1 during the contraction and 1 to 2 during the extension.
    """
    time = recording.camera_time[fitted_samples(recording)]
    gait, phase = recording.gait, np.mod(time * recording.gait.frequency, 1.0)
    share = gait.contraction_share
    part: Array = np.where(phase < share, phase / share, 1.0 + (phase - share) / (1.0 - share))
    return time, part


def _median(values: NDArray[np.float64]) -> float:
    return float(np.median(values)) if values.size else 0.0
