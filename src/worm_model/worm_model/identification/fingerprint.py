# SPDX-License-Identifier: Apache-2.0
"""Which code a result came from: a fingerprint of the source files that an identification imports, and of no others."""

from __future__ import annotations

import hashlib
from modulefinder import ModuleFinder
from pathlib import Path

PACKAGE = Path(__file__).resolve().parents[1]
ENTRY = "commands/identify.py"
VERSION = "0.1.0"


def code_version() -> str:
    """Version of the package, and the fingerprint."""
    digest = hashlib.sha256()
    for file in imported_files(PACKAGE, ENTRY):
        digest.update(str(file.relative_to(PACKAGE)).encode() + file.read_bytes())
    return f"worm_model {VERSION}, sources {digest.hexdigest()[:12]}"


def imported_files(package: Path, entry: str) -> list[Path]:
    """The source files of a package that one of them imports, itself included, directly or not, sorted."""
    finder = ModuleFinder([str(package.parent)])
    finder.run_script(str(package / entry))
    files = (getattr(module, "__file__", None) for module in finder.modules.values())
    return sorted({Path(file) for file in files if file})
