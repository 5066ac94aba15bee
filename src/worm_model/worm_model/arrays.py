# SPDX-License-Identifier: Apache-2.0
"""Types of arrays that most modules use."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Stamps = NDArray[np.int64]  # ns since the epoch
