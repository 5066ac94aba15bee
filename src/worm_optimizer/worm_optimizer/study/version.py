# SPDX-License-Identifier: Apache-2.0
"""Which code a process would compute with, so that a study is never mixed from two."""

from __future__ import annotations

import hashlib
import platform
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from worm_optimizer.search.cache import fingerprint

_NUMERIC = ("numpy", "scipy", "numba")  # whose versions may move last digits
_OTHERS = ("worm_model", "worm_optimizer", "xarray", "zarr", "distributed")


def versions() -> dict[str, str]:
    """Versions of this process's Python and packages, by name."""
    versions = {"python": platform.python_version()}
    for name in (*_NUMERIC, *_OTHERS):
        try:
            versions[name] = version(name)
        except PackageNotFoundError:  # run from a checkout
            versions[name] = "not installed"
    return versions


def identity() -> str:
    """Hash of the sources that decide about a study's numbers, and the versions of the numerical packages.

    Every worker must share it.
    """
    digest = hashlib.sha256(fingerprint().encode())
    for name in ("plan.py", "point.py"):
        digest.update((Path(__file__).parent / name).read_bytes())
    return " ".join([digest.hexdigest()[:24], *(f"{name}-{version(name)}" for name in _NUMERIC)])
