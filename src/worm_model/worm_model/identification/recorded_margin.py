# SPDX-License-Identifier: Apache-2.0
"""Measured margins of a recording for identification and health."""

from __future__ import annotations

import numpy as np

from worm_model.identification.data.observed_run import Recording
from worm_model.identification.fits.estimate import Estimate, not_identifiable, quantile
from worm_model.margin.half_cycles import Fin
from worm_model.margin.measured_margin import RunMargin, measure_cycles
from worm_model.parameters import Parameters
from worm_model.run import Run, TrackerSamples

NOT_MEASURED = "the tracker shows the switches of a fin in too few cycles"


def recorded_margin(recording: Recording, parameters: Parameters) -> RunMargin:
    """Return the measured margins of a recording."""
    stamps = np.rint(recording.camera_time * 1e9).astype(np.int64)
    run = Run(tracker=TrackerSamples(stamps, recording.x1, recording.x2))
    cycles = int(recording.end * recording.gait.frequency + 0.1)
    return measure_cycles(run, recording.gait, 0, cycles, parameters)


def margin_estimate(recording: Recording, parameters: Parameters) -> Estimate:
    """Return the smaller mean margin of both fins, m, with its 95 % interval."""
    margin = recorded_margin(recording, parameters)
    beliefs = [belief for fin in Fin if (belief := margin.belief(fin)) is not None]
    if len(beliefs) < len(Fin):
        return not_identifiable(np.nan, NOT_MEASURED)
    least = min(beliefs, key=lambda belief: belief.expected)
    half = quantile(np.inf) * least.expected_sd
    return Estimate(least.expected, least.expected - half, least.expected + half)
