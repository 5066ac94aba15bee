# SPDX-License-Identifier: Apache-2.0
"""Exact simulator, digital twin and identification of the worm."""

import os

# The matrices are small, so a second thread of the linear algebra gains nothing. On a busy computer both threads wait
# for each other, which takes ten times as long. NumPy reads the variable when it is loaded.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
