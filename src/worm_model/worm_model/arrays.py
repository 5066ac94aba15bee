# SPDX-License-Identifier: Apache-2.0
"""The kinds of arrays that most modules speak of."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Stamps = NDArray[np.int64]  # ns since the epoch
