# SPDX-License-Identifier: Apache-2.0
"""Decorators that compile the kernel.

Divisions follow IEEE 754 and do not raise exceptions. The compiler may reorder sums and fuse products with sums. This
changes only the last digits of the results, because no formula of the kernel relies on the order of a compensated sum.
The decorators `compiled` and `inlined` also let the compiler assume that no value is infinite or NaN: the inputs of a
run are checked first. Functions that Python calls (`entry`, `unlocked`, `exact`) handle NaN and infinity correctly.
"""

from numba import njit

_FAST = {"contract", "arcp", "nsz", "reassoc"}
_FINITE = _FAST | {"nnan", "ninf"}

compiled = njit(cache=True, error_model="numpy", fastmath=_FINITE)
# For small functions, and for functions with large tuples as arguments, which a call would copy
inlined = njit(cache=True, error_model="numpy", fastmath=_FINITE, forceinline=True)
# For functions that Python calls
entry = njit(cache=True, error_model="numpy", fastmath=_FAST)
# For long computations that Python calls: other threads run meanwhile
unlocked = njit(cache=True, error_model="numpy", fastmath=_FAST, nogil=True)
# For functions that Python calls, with the same rounding as NumPy
exact = njit(cache=True, error_model="numpy", nogil=True)
