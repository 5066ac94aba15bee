# SPDX-License-Identifier: Apache-2.0
"""The compiled kernel of the simulator: closed forms between events, events located, no step size.

Tuples and arrays of floats in, tuples and arrays out; the modules beside this package give them names.

Compiled code is cached on disk under a hash of all sources of the kernel, because the compiler itself
only notices a change in the file of the function that is called, not in the files of what that calls.
"""

from __future__ import annotations

import hashlib
import importlib
import os
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numba

SOURCES = sorted(Path(__file__).parent.glob("[!_]*.py"))


def cache_directory(more: Sequence[Path] = ()) -> Path:
    """Where code compiled from these sources and more is kept.

    That is NUMBA_CACHE_DIR, else the user's cache, else the temporary directory.
    """
    digest = hashlib.sha256()
    for source in (Path(__file__), *SOURCES, *more):
        digest.update(source.read_bytes())
    home = os.environ.get("XDG_CACHE_HOME") or Path("~/.cache").expanduser()
    base = Path(os.environ.get("NUMBA_CACHE_DIR") or Path(home) / "worm_model")
    for candidate in (base, Path(tempfile.gettempdir()) / f"worm_model-{os.getuid()}"):
        directory = candidate / f"kernel-{digest.hexdigest()[:16]}"
        try:
            directory.mkdir(parents=True, exist_ok=True)
        except OSError:
            continue
        if os.access(directory, os.W_OK):
            return directory
    raise OSError(
        f"no directory to keep the compiled kernel in: neither {base} nor the temporary directory can "
        "be written; set NUMBA_CACHE_DIR to one that can"
    )


def load_compiled(package: str, folder: Path) -> None:
    """Imports the modules of a package in a folder whose compiled code builds on the kernel, and is kept with it."""
    sources = sorted(folder.glob("[!_]*.py"))
    before = numba.config.CACHE_DIR
    own = folder == Path(__file__).parent
    numba.config.CACHE_DIR = str(cache_directory(() if own else sources))
    try:
        for source in sources:
            importlib.import_module(f"{package}.{source.stem}")
    finally:
        numba.config.CACHE_DIR = before


load_compiled(__name__, Path(__file__).parent)
