# SPDX-License-Identifier: Apache-2.0
"""Results on disk, named by the hash of all that they depend on.

Nothing is ever looked up by date or path: a new parameter file or setting is another name, so an
outdated result is never found. Files are written beside and moved into place, so that none is half
there after a crash, and one that is broken all the same counts as absent.
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import json
import os
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from worm_model.parameters import ParameterFile
from worm_optimizer.errors import OptimizerError
from worm_optimizer.settings import Settings

T = TypeVar("T")

FORMAT = 1  # to be raised when results change for the same input: new model, method or fields


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
    return _hash(dataclasses.replace(content, intervals={}), {"scan": used, "direction": direction})


def _hash(content: ParameterFile, rest: dict[str, Any]) -> str:
    everything = {
        "format": FORMAT,
        "parameters": content.parameters.as_dict(),
        "intervals": {key: list(bounds) for key, bounds in content.intervals.items()},
        **rest,
    }
    text = json.dumps(everything, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:24]


@dataclass(frozen=True)
class Cache:
    """Results as JSON files in a directory."""

    directory: Path

    @staticmethod
    def at(directory: Path) -> Cache:
        """A cache that is known to be writable; raises `OptimizerError` otherwise."""
        try:
            directory.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=directory):
                return Cache(directory)
        except OSError as error:
            raise OptimizerError(
                f"cache directory {directory}: cannot be written to ({error.strerror}): name another"
            ) from None

    def load(self, name: str, parse: Callable[[Any], T]) -> T | None:
        """The stored result as ``parse`` makes it of plain values; None if there is none that can be read."""
        with contextlib.suppress(OSError, ValueError, KeyError, TypeError):
            return parse(json.loads(self._path(name).read_text(encoding="utf-8")))
        return None

    def store(self, name: str, content: Any) -> None:
        """Stores a result in one step; raises OSError if the directory cannot be written to."""
        handle, temporary = tempfile.mkstemp(dir=self.directory, prefix=f".{name}-", text=True)
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
