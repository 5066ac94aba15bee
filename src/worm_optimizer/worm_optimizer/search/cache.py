# SPDX-License-Identifier: Apache-2.0
"""Results on disk, named by the hash of all that they depend on.

Nothing is ever looked up by date or path: a new parameter file or setting, or another version of the
code that computes, is another name, so an outdated result is never found. Files are written beside and
moved into place, so that none is half there after a crash, and one that is broken all the same counts
as absent.

The results of the paper's parameters and the default settings come with the package, under the same names: where the
code has changed since, they are not found, and computed as any other (`worm_optimizer.search.shipped`).
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import hashlib
import json
import os
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import worm_model
from worm_model.parameters import ParameterFile
from worm_optimizer.search.optimizer_errors import OptimizerError
from worm_optimizer.search.search_settings import Settings

T = TypeVar("T")

# All that results depend on beside their input: any change there is another name. Rather whole folders than a list of
# files that somebody forgets to extend.
_SOURCES: Mapping[Path, tuple[str, ...]] = {
    Path(worm_model.__file__).parent: (
        "errors.py",
        "gait.py",
        "parameters.py",
        "simulation/**/*.py",
    ),
    Path(__file__).parents[1]: ("search/*.py", "robustness/*.py"),
}
SHIPPED = Path(__file__).parents[1] / "config" / "fronts"  # what comes with the package
_PART = ".part"  # ends the name of a file that is being written
_ABANDONED = 3600.0  # s after which a file that was never moved into place is nobody's any more


def sources() -> list[Path]:
    """The source files that decide about a result."""
    files = (folder.glob(pattern) for folder, patterns in _SOURCES.items() for pattern in patterns)
    return sorted(path for paths in files for path in paths)


@functools.cache
def fingerprint() -> str:
    """Hash of `sources`."""
    digest = hashlib.sha256()
    for path in sources():
        digest.update(path.name.encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()


def default_directory() -> Path:
    """Where the desktop specification puts caches: $XDG_CACHE_HOME/worm_optimizer or in ~/.cache."""
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "worm_optimizer"


def key_of(content: ParameterFile, settings: Settings, direction: int) -> str:
    """Name of what follows from a parameter file (not its provenance), settings and a direction."""
    return _hash(content, {"settings": dataclasses.asdict(settings), "direction": direction})


def scan_key_of(content: ParameterFile, settings: Settings, direction: int) -> str:
    """Name of a margin scan: of the settings, only those matter that it uses."""
    used = {
        name: dataclasses.asdict(getattr(settings, name))
        for name in ("bounds", "limits", "map", "scan")
    }
    certain = ParameterFile(content.parameters)
    return _hash(certain, {"scan": used, "direction": direction})


def _hash(content: ParameterFile, rest: dict[str, Any]) -> str:
    everything = {
        "sources": fingerprint(),
        "parameters": content.parameters.as_dict(),
        "intervals": {key: list(bounds) for key, bounds in content.intervals.items()},
        "correlations": sorted([*pair, rho] for pair, rho in content.correlations.items()),
        "run_to_run": dict(content.run_to_run),
        **rest,
    }
    text = json.dumps(everything, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:24]


def _remove_abandoned(directory: Path) -> None:
    for path in directory.glob(f".*{_PART}"):
        with contextlib.suppress(OSError):  # somebody else was faster
            if time.time() - path.stat().st_mtime > _ABANDONED:
                path.unlink()


@dataclass(frozen=True)
class Cache:
    """Results as JSON files in a directory."""

    directory: Path

    @staticmethod
    def at(directory: Path) -> Cache:
        """A cache that is known to be writable; raises `OptimizerError` otherwise.

        What a process left behind that was killed while it wrote is removed.
        """
        try:
            directory.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=directory):
                _remove_abandoned(directory)
                return Cache(directory)
        except OSError as error:
            raise OptimizerError(
                f"cache directory {directory}: cannot be written to ({error.strerror}): name another"
            ) from None

    def load(self, name: str, parse: Callable[[Any], T]) -> T | None:
        """The stored result as ``parse`` makes it of plain values; None if there is none that can be read."""
        for place in (self, Cache(SHIPPED)):
            with contextlib.suppress(OSError, ValueError, KeyError, TypeError):
                return parse(json.loads(place._path(name).read_text(encoding="utf-8")))
        return None

    def store(self, name: str, content: Any) -> None:
        """Stores a result in one step; raises OSError if the directory cannot be written to."""
        handle, temporary = tempfile.mkstemp(
            dir=self.directory, prefix=".", suffix=_PART, text=True
        )
        try:
            with os.fdopen(handle, "w", encoding="utf-8") as file:
                json.dump(content, file)
                file.flush()
                os.fsync(file.fileno())
            Path(temporary).replace(self._path(name))
        except BaseException:
            Path(temporary).unlink(missing_ok=True)
            raise

    def _path(self, name: str) -> Path:
        return self.directory / f"{name}.json"
