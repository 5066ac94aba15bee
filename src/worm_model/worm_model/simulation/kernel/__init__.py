# SPDX-License-Identifier: Apache-2.0
"""Compiled kernel of the simulator: closed forms between located events, without a step size.

The functions take and return tuples and arrays of floats. `worm_model.simulation.rows` and the modules of the kernel
name the columns of these arrays.

Compiled code is cached on disk under a hash of all sources of the kernel, because the compiler itself only notices
changes in the file of the called function. It does not notice changes of functions in other files that this function
calls.
"""

from __future__ import annotations

import hashlib
import importlib
import logging
import os
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numba

SOURCES = sorted(Path(__file__).parent.glob("[!_]*.py"))


def cache_directory(more: Sequence[Path] = ()) -> Path:
    """Return the folder in which code compiled from these sources and ``more`` is cached.

    The folder is below NUMBA_CACHE_DIR or, without this variable, below the user's cache. If no folder can be written
    there, it is below the temporary directory.
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
        f"no directory for the compiled kernel: neither {base} nor the temporary directory can "
        "be written; set NUMBA_CACHE_DIR to a directory that can be written"
    )


def load_compiled(package: str, folder: Path, further: Sequence[Path] = ()) -> None:
    """Import all modules of a package of compiled code from a folder, and cache their code next to the kernel's.

    The name of the cache also depends on the contents of ``further`` files, whose constants are compiled in.

    The compiler caches the code of a file under the path of the file. A build folder contains links to the checkout.
    The links are resolved, so that build folder and checkout have the same paths, and the code is compiled once.
    """
    own = folder == Path(__file__).parent
    folder = folder.resolve()
    sys.modules[package].__path__ = [str(folder)]
    sources = sorted(folder.glob("[!_]*.py"))
    before = numba.config.CACHE_DIR
    cache = cache_directory(() if own else [*sources, *further])
    if not any(cache.iterdir()):
        logging.getLogger(package).warning(
            "%s is compiled at its first use, which takes a minute", package
        )
    numba.config.CACHE_DIR = str(cache)
    try:
        for source in sources:
            importlib.import_module(f"{package}.{source.stem}")
    finally:
        numba.config.CACHE_DIR = before


load_compiled(__name__, Path(__file__).parent)
