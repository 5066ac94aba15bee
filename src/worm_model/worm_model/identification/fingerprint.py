# SPDX-License-Identifier: Apache-2.0
"""Which code a result came from: a fingerprint of the source files that an identification imports, and of no others."""

from __future__ import annotations

import ast
import hashlib
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
    found, waiting = set(), [package / entry]
    while waiting:
        file = waiting.pop()
        if file in found:
            continue
        found.add(file)
        for module in _modules(ast.parse(file.read_bytes())):
            name, *parts = module.split(".")
            path = package.joinpath(*parts)
            candidates = (path.with_suffix(".py"), path / "__init__.py")
            if name == package.name:
                waiting += [candidate for candidate in candidates if candidate.is_file()]
    return sorted(found)


def _modules(tree: ast.Module) -> list[str]:
    """Everything that an import could name; what is no module is sorted out by looking for its file."""
    found = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            found += [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
    return found
