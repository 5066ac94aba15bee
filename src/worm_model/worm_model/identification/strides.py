# SPDX-License-Identifier: Apache-2.0
"""What x1 alone says of the pitch, before anything is fitted: a robot advances by whole grooves from cycle to cycle.

Between two moments one period apart the rear module stands alike in its groove, so that what it advanced is n·d. That
tells a pitch that was given wrongly, which all else would be fitted around: the front fin starts L0/d ≈ 17 grooves
ahead of the rear one.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from worm_model.identification.identification_errors import IdentificationError
from worm_model.identification.observed_run import Recording

# of a pitch from whole grooves, beyond which a fin was on its way at one of both moments
SLIPPING = 0.15
FEWEST = 20  # samples that tell something
# of the pitch, three times what strides are off on a robot whose grooves are not alike
TOLERANCE = 0.008


def pitch_of_strides(recording: Recording, pitch: float) -> float:
    """Pitch (m) as the strides of a run have it, counted in grooves of about a ``pitch`` (m); NaN of too few."""
    strides = _strides(recording)
    grooves = np.round(strides / pitch)
    whole = (grooves >= 1) & (np.abs(strides - grooves * pitch) < SLIPPING * pitch * grooves)
    if np.count_nonzero(whole) < FEWEST:
        return float("nan")
    return float(np.median(strides[whole] / grooves[whole]))


def _strides(recording: Recording) -> NDArray[np.float64]:
    """Advance over one period (m), from every camera sample on that lies between the first cycle and the last."""
    known = np.isfinite(recording.x1)
    time, x1 = recording.camera_time[known], recording.gait.direction * recording.x1[known]
    if time.size < FEWEST:
        return np.zeros(0)
    period = recording.gait.period
    begins = (time > period) & (time < min(recording.end, time[-1]) - period)
    later: NDArray[np.float64] = np.interp(time[begins] + period, time, x1)
    return later - x1[begins]


def check_pitch(recordings: Sequence[Recording], pitch: float, deviation: float = 0.0) -> None:
    """Refuses a pitch (m, as given to within a standard ``deviation``) that the strides of all runs contradict.

    Raises `IdentificationError`.
    """
    pitches = np.array([pitch_of_strides(recording, pitch) for recording in recordings])
    pitches = pitches[np.isfinite(pitches)]
    if not pitches.size:
        return
    median = float(np.median(pitches))
    if abs(median - pitch) > TOLERANCE * pitch + 3.0 * deviation:
        raise IdentificationError(
            f"pitch: given as {1e3 * pitch:.2f} mm, but the rear module gains {1e3 * median:.2f} mm a groove: "
            "measure the pitch anew (or the camera's scale), for nothing that is fitted under a wrong one holds"
        )
