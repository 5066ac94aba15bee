# SPDX-License-Identifier: Apache-2.0
"""Checksums of files and versions of packages, which identify the source of a result."""

import hashlib
import platform
from collections.abc import Iterable
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path


def sha256_of(file: Path) -> str:
    """Return the SHA-256 of a file's content."""
    with file.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def checksums_of(path: Path) -> dict[str, str]:
    """Return the SHA-256 of a file, or of each file in a folder, by the file's name."""
    files = [path] if path.is_file() else sorted(file for file in path.iterdir() if file.is_file())
    return {file.name: sha256_of(file) for file in files}


def versions_of(packages: Iterable[str]) -> dict[str, str]:
    """Return the version of Python and of each of the packages that is installed, by name."""
    versions = {"python": platform.python_version()}
    for package in packages:
        with suppress(PackageNotFoundError):  # without a Python distribution there is no version
            versions[package] = version(package)
    return versions
