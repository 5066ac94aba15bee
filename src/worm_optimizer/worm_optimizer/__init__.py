# SPDX-License-Identifier: Apache-2.0
"""Search for robust gaits, start and operation of the node graph, studies, reports and the console."""

import worm_model  # noqa: F401  # before NumPy, whose number of threads this import limits
