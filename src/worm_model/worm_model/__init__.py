# SPDX-License-Identifier: Apache-2.0
"""Exact simulator, digital twin and identification of the worm."""

import os

# Its matrices are small: a second thread of the linear algebra gains nothing, and on a busy computer both wait for each
# other, which takes ten times as long. It is read when NumPy is loaded.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
