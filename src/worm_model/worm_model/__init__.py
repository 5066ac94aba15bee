# SPDX-License-Identifier: Apache-2.0
"""Exact simulator, digital twin and identification of the worm."""

import os

# The matrices are small, so a second thread of the linear algebra saves no time. On a busy computer, the two threads
# wait for each other, and a computation takes ten times as long. The variable is read once, when NumPy is imported.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
