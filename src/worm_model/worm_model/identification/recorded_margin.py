# SPDX-License-Identifier: Apache-2.0
"""Measured margin of a recording, for `health`, and next to the predicted one, for `identify`."""

from __future__ import annotations

import numpy as np

from worm_model.identification.data.observed_run import Recording
from worm_model.identification.fits.estimate import Estimate, not_identifiable, quantile
from worm_model.identification.run_selection import FittedRun
from worm_model.margin.half_cycles import Fin
from worm_model.margin.measured_margin import RunMargin, measure_cycles
from worm_model.margin.predicted_margin import predicted_margin
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
    least = recorded_margin(recording, parameters).least
    if least is None:
        return not_identifiable(np.nan, NOT_MEASURED)
    half = quantile(np.inf) * least.expected_sd
    return Estimate(least.expected, least.expected - half, least.expected + half)


def compared_margin(run: FittedRun, parameters: Parameters) -> tuple[float, float]:
    """Return the least measured margin of a run's cycles and the predicted one, m; NaN if a fin was not measured.

    The least one decides whether the run keeps its grooves, which is what a success probability states.
    """
    margin = recorded_margin(run.recording, parameters)
    if margin.keeps is None:
        return np.nan, np.nan
    least = min(float(margin.margins(fin)[0].min()) for fin in Fin)
    known = parameters.replace(initial_length=run.length.initial_length)
    return least, predicted_margin(run.recording.gait, known, margin.grooves)
