# SPDX-License-Identifier: Apache-2.0
"""How the kernel is compiled.

Divisions follow IEEE 754 rather than raise; sums may be fused and reordered, which moves results in
their last digits only, as no formula here relies on the order of a compensated sum; NaN and infinity
keep their meaning.
"""

from numba import njit

_OPTIONS = {
    "cache": True,
    "error_model": "numpy",
    "fastmath": {"contract", "arcp", "nsz", "reassoc"},
}

compiled = njit(**_OPTIONS)
inlined = njit(
    forceinline=True, **_OPTIONS
)  # small, or called with large tuples that would be copied
unlocked = njit(nogil=True, **_OPTIONS)  # called from Python for long: other threads run meanwhile
