# SPDX-License-Identifier: Apache-2.0
"""Fingerprint of the source files of this package that an identification imports."""

from __future__ import annotations

import hashlib
from modulefinder import ModuleFinder
from pathlib import Path
from typing import Any

PACKAGE = Path(__file__).resolve().parents[1]
ENTRY = "commands/identify.py"  # file whose direct and indirect imports the fingerprint covers
VERSION = "1.0.0"  # of package.xml


def code_version() -> str:
    """Return a text with the version of this package and the fingerprint of its sources that `identify` imports."""
    digest = hashlib.sha256()
    for file in imported_files(PACKAGE, ENTRY):
        digest.update(str(file.relative_to(PACKAGE)).encode() + file.read_bytes())
    return f"worm_model {VERSION}, sources {digest.hexdigest()[:12]}"


class _OwnModules(ModuleFinder):
    """Module finder restricted to one package, without its neighbours in site-packages."""

    def __init__(self, package: Path) -> None:
        super().__init__([str(package.parent)])
        self._name = package.name

    def find_module(self, name: str, path: Any, parent: Any = None) -> Any:
        if path is None and name != self._name:
            raise ImportError(name)
        return super().find_module(name, path, parent)


def imported_files(package: Path, entry: str) -> list[Path]:
    """Return the sorted source files of a package that an entry file imports, directly or indirectly."""
    finder = _OwnModules(package)
    finder.run_script(str(package / entry))
    files = (getattr(module, "__file__", None) for module in finder.modules.values())
    return sorted({Path(file) for file in files if file})
