# SPDX-License-Identifier: Apache-2.0
"""Compiled core of the twin: samples in; rows of states, residuals, lengths and events out.

`sample_buffer` orders the samples, `estimator` advances the motion from sample to sample, `residuals` compares, and
`memory` declares the state. The estimator returns at boundaries that occur a few times per run (a driver state, the end
of a cycle), where Python decides (`worm_model.twin.twin`).
"""

from pathlib import Path

from worm_model.simulation.kernel import load_compiled

load_compiled(__name__, Path(__file__).parent)
