# SPDX-License-Identifier: Apache-2.0
"""Compiled core of the twin. It turns samples into rows of states, residuals, lengths and events.

`sample_buffer` orders the samples by stamp. `estimator` advances the motion from sample to sample. `residuals` compares
the measurements with the motion. `memory` declares the state of the twin. The estimator returns at boundaries, such as
a driver state or the end of a cycle, which `worm_model.twin.twin` handles in Python. A cycle contains few boundaries.
"""

from pathlib import Path

from worm_model.simulation.kernel import load_compiled

load_compiled(
    __name__, Path(__file__).parent, sorted((Path(__file__).parents[1] / "data").glob("*.py"))
)
