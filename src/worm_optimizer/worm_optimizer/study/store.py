# SPDX-License-Identifier: Apache-2.0
"""Zarr store of a study's results, written block by block and verified before each run.

The variables of a block are written first, its ``state`` next and its checksum last. A block without a checksum is
unfinished, and the next run computes it again. The checksum covers the points and all variables of the block, so that
an audit detects lost and damaged values. A Zarr chunk contains many blocks, so that a store has few files. Zarr
replaces a chunk atomically. A store contains no time and no place of its computation. A study that was killed and
resumed therefore ends with the same bytes. The format is Zarr version 2, which every release of xarray and zarr reads.
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import math
import os
import shutil
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import IO, Any

import dask.array
import numcodecs
import numpy as np
import xarray
import zarr
from dask.array.core import normalize_chunks, slices_from_chunks

from worm_model.errors import InputError
from worm_optimizer.code_version import identity, versions
from worm_optimizer.evaluation.servo_limits import servo_model
from worm_optimizer.study.plan import PARAMETER_FILE, SAMPLE, Array, Study
from worm_optimizer.study.point import FAILED, OPEN, Results, dimensions, variables
from worm_optimizer.study.quantities import QUANTITIES
from worm_optimizer.study.study_file import extends, format_study, identity_of, parse_study

# Errors of codecs. MemoryError: a damaged length field may exceed the memory.
_UNDECODABLE = (RuntimeError, ValueError, MemoryError, OverflowError)

Region = tuple[slice, ...]  # one slice for each dimension of the points

STATE, REASON, CHECKSUM = "state", "reason", "block_checksum"
_FORMAT = 2
_NEW = int(zarr.__version__.split(".")[0]) >= 3  # Python 3.10 needs an older release of zarr
# Nominal number of points in a chunk. The store then has few files, and rewriting the chunks of a block takes 50 ms.
_CHUNK_POINTS = 1024
_OTHER_COORDINATES = {
    PARAMETER_FILE: ("1", "parameter file of the robot"),
    SAMPLE: ("1", "number of the sample"),
    "front_gait": ("1", "gait of the front, by rising speed"),
    "gait": ("1", "gait, by its objective"),
    "scan_margin": ("m", "margin of the scan"),
}
_STUDY, _HASH, _CODE, _BLOCK = "study", "study_hash", "code", "block_shape"  # attributes


class StoreError(InputError):
    """The output cannot be used for this study. The message contains the reason and what to do."""


@dataclass
class Audit:
    """Result of an audit.

    Attributes:
        unfinished: blocks without a checksum.
        failed: intact blocks that contain failed points.
        damaged: blocks that contradict their checksum, or of which a chunk cannot be decoded.
        unreadable: files of chunks that cannot be decoded.
    """

    unfinished: list[Region] = field(default_factory=list)
    failed: list[Region] = field(default_factory=list)
    damaged: list[Region] = field(default_factory=list)
    unreadable: list[Path] = field(default_factory=list)


@dataclass(frozen=True)
class Store:
    """Output of a study, locked by this process.

    Attributes:
        path: folder of the store.
        study: study.
        points: points of the study, shape (*study.shape, len(study.varied)).
        block: shape of a block.
        repaired: files that were restored when the store was opened.
    """

    path: Path
    study: Study
    points: Array
    block: tuple[int, ...]
    repaired: tuple[str, ...] = ()

    def blocks(self) -> list[Region]:
        """Return all blocks."""
        return regions(self.study.shape, self.block)

    def audit(self) -> Audit:
        """Read the whole store and compare each finished block with its checksum."""
        group, audit = self._group("r"), Audit()
        names = [*variables(self.study), STATE, REASON]
        for chunk in regions(self.study.shape, chunk_shape(self.study, self.block)):
            values: Results = {}
            for name in (*names, CHECKSUM):
                try:
                    values[name] = group[name][chunk]
                except _UNDECODABLE:
                    audit.unreadable.append(self._file(chunk, name))
            for inner in regions([part.stop - part.start for part in chunk], self.block):
                block = tuple(
                    slice(part.start + offset.start, part.start + offset.stop)
                    for part, offset in zip(chunk, inner, strict=True)
                )
                here = {name: array[inner] for name, array in values.items()}
                sums = here.pop(CHECKSUM, None)
                if sums is not None and not sums.all():
                    audit.unfinished.append(block)
                elif (
                    sums is None
                    or len(here) < len(names)
                    or np.any(sums != _checksum(here, self.points[block]))
                ):
                    audit.damaged.append(block)
                elif np.any(here[STATE] == FAILED):
                    audit.failed.append(block)
        return audit

    def reset(self, audit: Audit) -> None:
        """Replace each chunk that an audit could not decode by an empty one, as in a new store."""
        group = self._group("r+")
        for file in audit.unreadable:
            file.unlink()
            array = group[file.parent.name]
            places = map(int, file.name.split("."))
            region = tuple(
                slice(place * size, (place + 1) * size)
                for place, size in zip(places, array.chunks, strict=True)
            )
            array[region] = _blank(file.parent.name)

    def counts(self) -> tuple[int, int]:
        """Return the number of finished points and the number of failed points among them."""
        group, finished, failed = self._group("r"), 0, 0
        for chunk in regions(self.study.shape, chunk_shape(self.study, self.block)):
            done = group[CHECKSUM][chunk] != 0
            finished += int(np.count_nonzero(done))
            failed += int(np.count_nonzero(done & (group[STATE][chunk] == FAILED)))
        return finished, failed

    def write(self, block: Region, results: Results) -> None:
        """Write a finished block.

        Args:
            block: region of the block.
            results: variables of its points by name, each of shape (points, …).

        Raises:
            OSError: The disk is full or cannot be written.
        """
        group = self._group("r+")
        shape = [part.stop - part.start for part in block]
        values = {name: array.reshape(*shape, *array.shape[1:]) for name, array in results.items()}
        values[CHECKSUM] = np.full(shape, _checksum(values, self.points[block]), np.uint32)
        for name in sorted(values, key=lambda name: (name == CHECKSUM, name == STATE)):
            group[name][block] = values[name]

    def _group(self, mode: Any) -> Any:
        return zarr.open_group(str(self.path), mode=mode)

    def _file(self, chunk: Region, name: str) -> Path:
        shape = chunk_shape(self.study, self.block)
        places = [part.start // size for part, size in zip(chunk, shape, strict=True)]
        further = variables(self.study)[name].dimensions if name in variables(self.study) else ()
        return self.path / name / ".".join(map(str, [*places, *(0 for _ in further)]))


def block_shape(study: Study) -> tuple[int, ...]:
    """Return the shape of a block of at most ``block_points`` points, longest along the last dimensions."""
    left, shape = study.block_points, []
    for size in reversed(study.shape):
        shape.append(max(1, min(size, left)))
        left //= shape[-1]
    return tuple(reversed(shape))


def chunk_shape(study: Study, block: Sequence[int]) -> tuple[int, ...]:
    """Return the shape of a chunk: a multiple of the shape of a block, with about `_CHUNK_POINTS` points.

    The shape does not depend on the number of samples, so that the study can be extended.
    """
    left, chunk = max(_CHUNK_POINTS // math.prod(block), 1), []
    for (name, values), part in zip(
        reversed(study.dimensions.items()), reversed(block), strict=True
    ):
        many = left if name == SAMPLE else max(1, min(math.ceil(len(values) / part), left))
        chunk.append(many * part)
        left //= many
    return tuple(reversed(chunk))


def regions(shape: Sequence[int], part: Sequence[int]) -> list[Region]:
    """Divide an array of a shape into regions of the shape ``part``. Regions at its ends may be smaller."""
    return list(slices_from_chunks(normalize_chunks(part, shape=tuple(shape))))


def _checksum(values: Results, points: Array) -> int:
    """Return the CRC-32 of the values and points of a block, never 0."""
    total = zlib.crc32(np.ascontiguousarray(points).tobytes())
    for name in sorted(values):
        array = values[name]
        if name == REASON:
            data = "\0".join(map(str, array.ravel())).encode()
        else:
            data = np.ascontiguousarray(array).tobytes()
        total = zlib.crc32(data, total)
    return total or 1


def _blank(name: str) -> Any:
    return {STATE: OPEN, CHECKSUM: 0, REASON: ""}.get(name, np.nan)


def open_result(path: str | Path) -> xarray.Dataset:
    """Return the dataset of a study, which reads values on access.

    The results of points that were not computed are NaN. A block that a killed process was writing may be incomplete
    until the study is continued.
    """
    return xarray.open_zarr(str(path), consolidated=True)


def stored_study(path: Path) -> Study:
    """Return the study that a store contains.

    Raises:
        StoreError: The path contains no study, or its description is damaged.
    """
    attributes = _attributes(path)
    try:
        study = parse_study(attributes[_STUDY], Path())
    except InputError as error:
        raise StoreError(f"{path}: the description of the study is damaged: {error}") from None
    if identity_of(study) != attributes[_HASH]:
        raise StoreError(f"{path}: the description of the study is damaged: its hash differs")
    return replace(study, text=attributes.get("study_file", study.text))


def is_of_this_code(path: Path) -> bool:
    """Return True if this version of the code computed the results of a store."""
    return bool(_attributes(path)[_CODE] == identity())


@contextlib.contextmanager
def locked_store(path: Path, study: Study) -> Iterator[Store]:
    """Create the output of a study if it is missing, and lock it for this process.

    A store of a study with fewer samples of the same sequence is extended.

    Yields:
        The store.

    Raises:
        StoreError: The folder of the output is missing. The output contains no study or another one, its description is
            damaged, another version of the code began it, or another process uses it.
    """
    made = not path.exists() and _make(path, study)
    with _locked(path):
        attributes = _attributes(path)
        stored = study if attributes[_HASH] == identity_of(study) else stored_study(path)
        if stored is not study and not extends(study, stored):
            raise StoreError(
                f"{path}: contains another study ({attributes.get('title', '')}); "
                "choose another name, nothing is overwritten"
            )
        if attributes[_CODE] != identity():
            raise StoreError(
                f"{path}: was begun by another version (code {attributes[_CODE]}, this is {identity()}); "
                "continue with that version, or choose another name"
            )
        for partial in path.rglob("*.partial"):  # Zarr was writing it when a process was killed
            partial.unlink()
        block = tuple(attributes[_BLOCK])
        repaired = () if made else _installed(path, study, block)
        if stored is not study:
            _clear_samples(path, stored.shape[-1])
            repaired = ()
        yield Store(path, study, study.points(), block, repaired)


@contextlib.contextmanager
def existing_store(path: Path) -> Iterator[Store]:
    """Lock an existing store without changing it.

    Yields:
        The store.

    Raises:
        StoreError: The path contains no study, or another process uses it, or its description is damaged.
    """
    with _locked(path):
        study = stored_study(path)
        yield Store(path, study, study.points(), tuple(_attributes(path)[_BLOCK]))


@contextlib.contextmanager
def _locked(path: Path) -> Iterator[None]:
    marker = path / ".zgroup"
    if not marker.is_file():
        raise _no_study(path)
    with marker.open("r+b") as file:
        lock(file, path)
        yield


def lock(file: IO[Any], output: Path) -> None:
    """Lock a file for this process until it is closed.

    Raises:
        StoreError: Another process holds the lock of ``output``.
    """
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise StoreError(
            f"{output}: another process works on it; wait for it, or choose another name"
        ) from None


def check_folder(output: Path) -> None:
    """Check that the folder of an output exists.

    Raises:
        StoreError: The folder is missing.
    """
    if not output.parent.is_dir():
        raise StoreError(f"{output}: the folder {output.parent} does not exist; create it first")


def _no_study(path: Path) -> StoreError:
    return StoreError(
        f"{path}: is not a study; choose another name, nothing is overwritten"
        if path.exists()
        else f"{path}: does not exist"
    )


def _attributes(path: Path) -> dict[str, Any]:
    """Return the attributes of a store.

    Raises:
        StoreError: The path contains no study, or one that an earlier version of the code began, or it is damaged.
    """
    try:
        content = json.loads((path / ".zattrs").read_text(encoding="utf-8"))
    except OSError:
        raise _no_study(path) from None
    except ValueError:
        raise StoreError(f"{path}: the description of the study is damaged") from None
    if not isinstance(content, dict) or not {_STUDY, _HASH, _CODE} <= set(content):
        raise _no_study(path)
    if _BLOCK not in content:
        raise StoreError(f"{path}: was begun by an earlier version; choose another name")
    return content


def _make(path: Path, study: Study) -> bool:
    """Create an empty store under a temporary name and rename it, so that none is ever incomplete under its own name.

    Return False if another process has created the store, which is then used. Raises `StoreError` if that fails.
    """
    check_folder(path)
    with _template(path, study, block_shape(study)) as part:
        try:
            part.rename(path)
        except OSError as error:
            if not path.exists():
                raise StoreError(f"{path}: cannot be created: {error.strerror}") from None
            return False
    return True


def _installed(path: Path, study: Study, block: tuple[int, ...]) -> tuple[str, ...]:
    """Restore missing or damaged metadata and coordinates of a store, and return the names of the restored files.

    Missing files of state, reason and checksum are restored as not computed. The names of files in the root folder of
    the store are not returned.
    """
    different = []
    with _template(path, study, block) as part:
        files = sorted(file.relative_to(part) for file in part.rglob("*") if file.is_file())
        for name in sorted(files, key=lambda name: (len(name.parts) == 1, name)):  # attributes last
            target = path / name
            results = name.parts[0] in (STATE, REASON, CHECKSUM) and not name.name.startswith(".")
            if target.is_file() and (results or target.read_bytes() == (part / name).read_bytes()):
                continue
            # The attributes in the root folder contain versions of packages, which may change.
            if len(name.parts) > 1:
                different.append(str(name))
            target.parent.mkdir(exist_ok=True)
            (part / name).replace(target)
    return tuple(different)


def _clear_samples(path: Path, first: int) -> None:
    """Mark the samples from ``first`` on as not computed."""
    group = zarr.open_group(str(path), mode="r+")
    for name in (STATE, REASON, CHECKSUM):
        group[name][..., first:] = _blank(name)


@contextlib.contextmanager
def _template(path: Path, study: Study, block: tuple[int, ...]) -> Iterator[Path]:
    """Write an empty store under a temporary name next to ``path``, yield its path, and remove it at the end."""
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        dataset = _empty(study, block)
        encoding = {name: _encoding(study, block, dataset[name]) for name in dataset.variables}
        dataset.to_zarr(
            part,
            mode="w-",
            zarr_format=_FORMAT,
            consolidated=True,
            compute=False,
            encoding=encoding,
        )
        yield part
    finally:
        shutil.rmtree(part, ignore_errors=True)


def _encoding(study: Study, block: tuple[int, ...], array: xarray.DataArray) -> dict[str, Any]:
    """Return the encoding of a variable.

    The compressor uses one thread, so that the same numbers result in the same bytes.
    """
    coordinate = array.name in array.coords
    points = chunk_shape(study, block)
    chunks = array.shape if coordinate else (*points, *array.shape[len(points) :])
    compressor = numcodecs.Zstd(level=1, checksum=True)  # detects damage before strings are decoded
    return {
        **({"chunks": chunks} if chunks else {}),
        **({"compressors": [compressor]} if _NEW else {"compressor": compressor}),
        "_FillValue": np.nan if array.dtype.kind == "f" and not coordinate else None,
    }


def _empty(study: Study, block: tuple[int, ...]) -> xarray.Dataset:
    """Return a dataset with names, units, points and provenance, but without results."""
    along, shape, chunk = tuple(study.dimensions), study.shape, chunk_shape(study, block)
    sizes = {name: len(values) for name, values in dimensions(study).items()}
    data: dict[str, Any] = {}
    for name, variable in variables(study).items():
        further = tuple(sizes[each] for each in variable.dimensions)
        empty = dask.array.full((*shape, *further), np.nan, chunks=(*chunk, *further))
        attributes = {"units": variable.unit, "long_name": variable.long_name}
        data[name] = ((*along, *variable.dimensions), empty, attributes)
    # The following variables have no fill value that would mean "not written". Their chunks are written immediately.
    flags = {"flag_values": [0, 1, 2], "flag_meanings": "not_computed computed failed"}
    data[STATE] = (along, np.zeros(shape, np.int8), {"long_name": "state of the point", **flags})
    data[REASON] = (along, np.full(shape, "", object), {"long_name": "why the point failed"})
    data[CHECKSUM] = (
        along,
        np.zeros(shape, np.uint32),
        {"long_name": "CRC-32 of the points and values of the block, 0 if it is not computed"},
    )
    return xarray.Dataset(data, _coordinates(study), _provenance(study, block))


def _coordinates(study: Study) -> dict[str, Any]:
    """Return all coordinates: the points, the fixed quantities as scalars, and the further dimensions."""
    names = np.array([name for name, _ in study.files], dtype=object)
    values: dict[str, Any] = {PARAMETER_FILE: ((), names[0])}
    values |= {name: ((), value) for name, value in study.fixed.items()}
    values |= {name: (name, np.asarray(each)) for name, each in study.dimensions.items()}
    if len(study.files) > 1:
        values[PARAMETER_FILE] = (PARAMETER_FILE, names)
    points = study.points().reshape(-1, study.shape[-1], len(study.varied))[0]
    for axis in study.ranges:
        values[axis.name] = (SAMPLE, points[:, study.varied.index(axis.name)])
    used = {name for variable in variables(study).values() for name in variable.dimensions}
    for name, each in dimensions(study).items():
        if name in used:
            text = any(isinstance(value, str) for value in each)
            values[name] = (name, np.array(each, dtype=object if text else None))
    return {name: (along, each, _described(name)) for name, (along, each) in values.items()}


def _described(name: str) -> dict[str, str]:
    if name in QUANTITIES:
        return {"units": QUANTITIES[name].unit, "long_name": QUANTITIES[name].long_name}
    unit, long_name = _OTHER_COORDINATES[name]
    return {"units": unit, "long_name": long_name}


def _provenance(study: Study, block: tuple[int, ...]) -> dict[str, Any]:
    """Return the attributes of a store: everything that determines its numbers, but no time or place."""
    model = servo_model(study.hardware.model)
    return {
        "Conventions": "CF-1.11",
        "title": study.title,
        "study_file": study.text,
        _STUDY: format_study(study),
        _HASH: identity_of(study),
        **({"servo_model": json.dumps(asdict(model))} if model else {}),
        _CODE: identity(),
        "versions": json.dumps(versions()),
        _BLOCK: list(block),
    }
