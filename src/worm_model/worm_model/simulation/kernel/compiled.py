# SPDX-License-Identifier: Apache-2.0
"""Decorators that compile the kernel.

Divisions follow IEEE 754 and do not raise. Sums may be fused and reordered. This changes only the last digits of the
results, because no formula here relies on the order of a compensated sum. Within a run nothing is infinite or NaN,
because the inputs are checked first. Functions that Python calls (`entry`, `unlocked`) preserve NaN and infinity.
"""

from numba import njit

_FAST = {"contract", "arcp", "nsz", "reassoc"}
_FINITE = _FAST | {"nnan", "ninf"}

compiled = njit(cache=True, error_model="numpy", fastmath=_FINITE)
# For functions that are small, or are called with large tuples that would be copied
inlined = njit(cache=True, error_model="numpy", fastmath=_FINITE, forceinline=True)
# For functions that Python calls
entry = njit(cache=True, error_model="numpy", fastmath=_FAST)
# For long computations that Python calls: other threads run meanwhile
unlocked = njit(cache=True, error_model="numpy", fastmath=_FAST, nogil=True)
