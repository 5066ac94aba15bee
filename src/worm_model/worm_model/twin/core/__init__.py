# SPDX-License-Identifier: Apache-2.0
"""The twin's compiled core: samples in the order of their stamps in, rows of states and residuals out.

`intake` puts samples in order, `following` lets the motion go from sample to sample and compares; `memory` is all
that is remembered. What happens a few times in a run (a word of the driver, the end of a cycle) is handed back to
Python, which decides it (`worm_model.twin.twin`).
"""

from pathlib import Path

from worm_model.simulation.kernel import load_compiled

load_compiled(__name__, Path(__file__).parent)
