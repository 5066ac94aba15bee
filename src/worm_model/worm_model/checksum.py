# SPDX-License-Identifier: Apache-2.0
"""Checksums of files, which identify the source of a result."""

import hashlib
from collections.abc import Iterable
from pathlib import Path

_PIECE = 1 << 20  # bytes read at a time


def sha256_of(files: Iterable[Path]) -> str:
    """Return a single SHA-256 of the concatenated content of files."""
    digest = hashlib.sha256()
    for file in files:
        with file.open("rb") as stream:
            while piece := stream.read(_PIECE):
                digest.update(piece)
    return digest.hexdigest()


def checksums_of(path: Path) -> dict[str, str]:
    """Return the SHA-256 of a file, or of each file in a folder, by the file's name."""
    files = [path] if path.is_file() else sorted(file for file in path.iterdir() if file.is_file())
    return {file.name: sha256_of([file]) for file in files}
