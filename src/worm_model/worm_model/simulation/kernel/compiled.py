# SPDX-License-Identifier: Apache-2.0
"""How the kernel is compiled.

Divisions follow IEEE 754 rather than raise. Sums may be fused and reordered, which moves results in their
last digits only, as no formula here relies on the order of a compensated sum. Within a run nothing is
infinite or not a number, its inputs are checked before; the entries of `simulation.kernel.whole_run` and what
fills tables keep the meaning of NaN and infinity.
"""

from numba import njit

_FAST = {"contract", "arcp", "nsz", "reassoc"}
_FINITE = _FAST | {"nnan", "ninf"}

compiled = njit(cache=True, error_model="numpy", fastmath=_FINITE)
# small, or called with large tuples that would be copied
inlined = njit(cache=True, error_model="numpy", fastmath=_FINITE, forceinline=True)
# called from Python
entry = njit(cache=True, error_model="numpy", fastmath=_FAST)
# the same for long: other threads run meanwhile
unlocked = njit(cache=True, error_model="numpy", fastmath=_FAST, nogil=True)
