# SPDX-License-Identifier: Apache-2.0
"""Zarr store of a study's results, written block by block. Each block of the study is a chunk.

The variables of a block are written first and its ``state`` last, so a block counts as finished only if it is
complete. An interrupted block is computed again. The store does not depend on when or where it was computed. A study
that was killed and resumed therefore ends with the same bytes. The format is Zarr version 2, which every release of
xarray and zarr reads.
"""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import json
import os
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import dask.array
import numcodecs
import numpy as np
import xarray
import zarr

from worm_model.errors import InputError
from worm_model.parameters import format_parameter_file
from worm_optimizer.study.plan import PARAMETER_FILE, QUANTITY_UNITS, Study
from worm_optimizer.study.point import FAILED, OPEN, REASON_LENGTH, Results, dimensions, variables
from worm_optimizer.study.version import identity, versions

_FORMAT = 2
_NEW = int(zarr.__version__.split(".")[0]) >= 3  # Python 3.10 needs an older release
_DIMENSION_UNITS = {"front_gait": "1", "gait": "", "scan_margin": "m"}


class StoreError(InputError):
    """The output cannot be used for this study. The message contains the reason and what to do."""


@dataclass(frozen=True)
class Store:
    """Output of a study, locked by this process."""

    path: Path
    study: Study

    def open_blocks(self) -> list[slice]:
        """Return the blocks that are not finished."""
        state = self._group("r")["state"]
        return [block for block in self.study.blocks if np.any(state[block] == OPEN)]

    def counts(self) -> tuple[int, int]:
        """Return the number of finished points and the number of failed points among them."""
        state = self._group("r")["state"]
        finished = failed = 0
        for block in self.study.blocks:
            part = state[block]
            finished += int(np.count_nonzero(part != OPEN))
            failed += int(np.count_nonzero(part == FAILED))
        return finished, failed

    def write(self, block: slice, results: Results) -> None:
        """Write a finished block.

        Raises:
            OSError: The disk is full or cannot be written.
        """
        group = self._group("r+")
        for name in sorted(results, key=lambda name: name == "state"):
            group[name][block] = results[name]

    def _group(self, mode: Any) -> Any:
        return zarr.open_group(str(self.path), mode=mode)


def open_result(path: str | Path) -> xarray.Dataset:
    """Return the dataset of a study, which is read lazily. Unfinished points are NaN."""
    return xarray.open_zarr(str(path), consolidated=True)


@contextlib.contextmanager
def held(path: Path, study: Study) -> Iterator[Store]:
    """Create the output of a study if it is missing, and lock it for this process.

    Yields:
        The store.

    Raises:
        StoreError: The output holds another study, was made by another version of the code, or is in use.
    """
    if not path.exists():
        _make(path, study)
    marker = path / ".zgroup"
    if not marker.is_file():
        raise StoreError(
            f"{path}: exists already and is no study; give another name, nothing is overwritten"
        )
    with marker.open("r+b") as file:
        take(file, path)
        _check(path, study)
        yield Store(path, study)


def take(file: IO[Any], output: Path) -> None:
    """Lock a file for this process until it is closed.

    Raises:
        StoreError: Another process holds the lock of ``output``.
    """
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise StoreError(
            f"{output}: another process works on it; wait for it, or give another name"
        ) from None


def check_folder(output: Path) -> None:
    """Check that the folder of an output exists.

    Raises:
        StoreError: The folder is missing.
    """
    if not output.parent.is_dir():
        raise StoreError(f"{output}: its folder {output.parent} does not exist; make it first")


def _check(path: Path, study: Study) -> None:
    """Check that an output holds this study and was made by this code.

    Raises:
        StoreError: It does not.
    """
    try:
        attributes = json.loads((path / ".zattrs").read_text(encoding="utf-8"))
        study_hash, code = attributes["study_hash"], attributes["code"]
    except (OSError, ValueError, KeyError, TypeError):
        raise StoreError(
            f"{path}: exists already and is no study; give another name, nothing is overwritten"
        ) from None
    if study_hash != study.identity:
        raise StoreError(
            f"{path}: holds another study ({attributes.get('title', '')}); give another name, nothing is overwritten"
        )
    if code != identity():
        raise StoreError(
            f"{path}: was begun by another version (code {code}, this is {identity()}); "
            "go on with that one, or give another name"
        )


def _make(path: Path, study: Study) -> None:
    """Create an empty store under a temporary name and rename it, so that no incomplete store remains."""
    check_folder(path)
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        dataset = _template(study)
        encoding = {name: _encoding(study, dataset[name]) for name in dataset.variables}
        dataset.to_zarr(
            part,
            mode="w-",
            zarr_format=_FORMAT,
            consolidated=True,
            compute=False,
            encoding=encoding,
        )
        # If another process has created the store, that one is used.
        with contextlib.suppress(OSError):
            part.rename(path)
    finally:
        shutil.rmtree(part, ignore_errors=True)


def _encoding(study: Study, array: xarray.DataArray) -> dict[str, Any]:
    """Return the encoding of a variable: one chunk per block.

    The compressor uses one thread, so that the same numbers result in the same bytes.
    """
    coordinate = array.name in array.coords
    chunks = tuple(
        size if coordinate or name != "point" else study.block_points
        for name, size in array.sizes.items()
    )
    compressor = numcodecs.Zstd(level=1)
    return {
        "chunks": chunks,
        **({"compressors": [compressor]} if _NEW else {"compressor": compressor}),
        "_FillValue": np.nan if array.dtype.kind == "f" and not coordinate else None,
    }


def _template(study: Study) -> xarray.Dataset:
    """Return the dataset without results: names, units, points and provenance."""
    sizes = {name: len(values) for name, values in dimensions(study).items()}
    data: dict[str, Any] = {}
    for name, variable in variables(study).items():
        shape = (study.size, *(sizes[d] for d in variable.dimensions))
        chunks = (study.block_points, *shape[1:])
        empty = dask.array.full(shape, np.nan, chunks=chunks)
        attributes = {"units": variable.unit, "long_name": variable.long_name}
        data[name] = (("point", *variable.dimensions), empty, attributes)
    for name, dtype, words in (
        ("state", np.dtype("u1"), "0 not finished, 1 done, 2 failed"),
        ("reason", np.dtype(f"<U{REASON_LENGTH}"), "why a point failed"),
    ):
        # Written immediately, because no value could mark unwritten chunks.
        data[name] = ("point", np.zeros(study.size, dtype), {"long_name": words})
    used = {name for variable in variables(study).values() for name in variable.dimensions}
    coordinates: dict[str, Any] = {
        name: (name, values, {"units": _DIMENSION_UNITS[name]} if _DIMENSION_UNITS[name] else {})
        for name, values in dimensions(study).items()
        if name in used
    }
    points = study.points()
    for column, name in enumerate(study.varied):
        if name == PARAMETER_FILE:
            names = np.array([file for file, _ in study.files])
            coordinates[name] = ("point", names[points[:, column].astype(int)])
        else:
            attributes = {"units": QUANTITY_UNITS[name]}
            coordinates[name] = ("point", points[:, column], attributes)
    return xarray.Dataset(data, coordinates, _provenance(study))


def _provenance(study: Study) -> dict[str, Any]:
    """Return everything that determines the numbers, without time and place of the computation."""
    parameters = "".join(format_parameter_file(content) for _, content in study.files)
    return {
        "title": study.title,
        "study": study.text,
        "study_hash": study.identity,
        "parameters": [name for name, _ in study.files],
        "parameter_hash": hashlib.sha256(parameters.encode()).hexdigest()[:24],
        "fixed": json.dumps(dict(study.fixed)),
        "code": identity(),
        "versions": json.dumps(versions()),
        "Conventions": "SI units in the attribute units",
    }
