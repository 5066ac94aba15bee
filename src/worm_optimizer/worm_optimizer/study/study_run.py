# SPDX-License-Identifier: Apache-2.0
"""Run of a study: computation of the points that no stored block contains, and the NetCDF file of all results.

The file contains no time and no place of its computation: equal values result in equal bytes.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import xarray

from worm_model.checksum import versions_of
from worm_model.errors import InputError
from worm_model.parameters import format_parameter_file
from worm_optimizer.code_version import PACKAGES, code_identity
from worm_optimizer.evaluation.servo_limits import servo_model
from worm_optimizer.study.blocks import (
    ITEMS,
    Block,
    Counts,
    Say,
    Task,
    Workers,
    complete,
    keys_of,
    new_output,
)
from worm_optimizer.study.plan import PARAMETER_FILE, QUANTITIES, SAMPLE, Study
from worm_optimizer.study.point import (
    DONE,
    FAILED,
    FRONT,
    GAIT,
    SCAN,
    compute_block,
    dimensions,
    variables,
)

STATE, REASON = "state", "reason"
_HASH = "study_hash"  # attribute
_OTHER_COORDINATES = {
    PARAMETER_FILE: ("1", "parameter file of the robot"),
    SAMPLE: ("1", "number of the sample"),
    FRONT: ("1", "gait of the front, by rising speed"),
    GAIT: ("1", "gait, by its objective"),
    SCAN: ("m", "margin of the scan"),
}


def run_study(
    study: Study, output: Path, workers: Workers, say: Say, progress: Callable[[float], None]
) -> Counts:
    """Compute a study into the NetCDF file ``output``, or check that the file contains its results already.

    If this fails, the finished blocks remain in a folder next to the output, and calling it again computes the others.

    Args:
        study: study.
        output: NetCDF file.
        workers: workers to use.
        say: function that is called with each message.
        progress: function that is called with the finished share of the points, 0 to 1.

    Raises:
        InputError: The output or the cluster cannot be used, or the output contains something else.
        LostError: The cluster was lost.
        OSError: The output cannot be written.
    """
    if not output.exists():
        task = Task(compute_block, study, study.points(), study.block_points, study.identity())
        content = _dataset(study, complete(task, output, workers, say, progress))
        with new_output(output) as part:
            # not to a path, for which xarray takes a lock from Dask's last client, even if that one is closed
            part.write_bytes(content.to_netcdf(engine="scipy", format="NETCDF3_64BIT"))
    with _opened(output) as data:
        if data.attrs.get(_HASH) != _hash(study):
            raise InputError(
                f"{output}: exists already, and contains something else or was computed by another version; "
                "choose another name, nothing is overwritten"
            )
        failed = np.count_nonzero(data[STATE] == FAILED)
    return Counts(study.size, study.size, int(failed))


def _opened(output: Path) -> xarray.Dataset:
    try:
        return xarray.open_dataset(output, engine="scipy")
    except (OSError, TypeError, ValueError, IndexError, KeyError) as error:
        raise InputError(
            f"{output}: is no result of a study, or is damaged ({' '.join(str(error).split())}); "
            "move it away and repeat the command, which writes it again from its blocks"
        ) from None


def _dataset(study: Study, found: Sequence[Block]) -> xarray.Dataset:
    """Return the results of a study with names, units and provenance."""
    results = {name: np.concatenate([block[name] for block in found]) for name in found[0]}
    rows = {key: row for row, key in enumerate(keys_of(results[ITEMS]))}
    order = [rows[key] for key in keys_of(study.points())]
    flags = {"flag_values": np.array([DONE, FAILED], np.int8), "flag_meanings": "computed failed"}
    described: dict[str, tuple[tuple[str, ...], dict[str, Any]]] = {
        **{
            name: (each.dimensions, {"units": each.unit, "long_name": each.long_name})
            for name, each in variables(study).items()
        },
        STATE: ((), {"long_name": "state of the point", **flags}),
        REASON: ((), {"long_name": "why the point failed"}),
    }
    data: dict[str, Any] = {}
    for name, (further, attributes) in described.items():
        values = results[name][order]
        shaped = values.reshape(*study.shape, *values.shape[1:])
        if name == REASON:
            shaped = shaped.astype(object)
        data[name] = ((*study.dimensions, *further), shaped, attributes)
    used = {name for further, _ in described.values() for name in further}
    return xarray.Dataset(data, _coordinates(study, used), _provenance(study))


def _coordinates(study: Study, used: set[str]) -> dict[str, Any]:
    """Return all coordinates: the points, the fixed quantities as scalars, and the further dimensions ``used``."""
    names = np.array([name for name, _ in study.files], dtype=object)
    values: dict[str, Any] = {PARAMETER_FILE: ((), names[0])}
    values |= {name: ((), value) for name, value in study.fixed.items()}
    values |= {name: (name, np.asarray(each)) for name, each in study.dimensions.items()}
    if len(study.files) > 1:
        values[PARAMETER_FILE] = (PARAMETER_FILE, names)
    samples = study.points()[: study.shape[-1]]
    for axis in study.ranges:
        values[axis.name] = (SAMPLE, samples[:, study.varied.index(axis.name)])
    for name, each in dimensions(study).items():
        if name in used:
            values[name] = (name, np.array(each, dtype=object if name == GAIT else None))
    return {name: (along, each, _described(name)) for name, (along, each) in values.items()}


def _described(name: str) -> dict[str, str]:
    if name in QUANTITIES:
        return {"units": QUANTITIES[name].unit, "long_name": QUANTITIES[name].long_name}
    unit, long_name = _OTHER_COORDINATES[name]
    return {"units": unit, "long_name": long_name}


def _provenance(study: Study) -> dict[str, Any]:
    """Return the attributes of a result: everything that determines its numbers, but no time or place."""
    driver, model = study.hardware.driver, servo_model(study.hardware.model)
    files = {name: format_parameter_file(content) for name, content in study.files}
    return {
        "Conventions": "CF-1.11",
        "title": study.title,
        "study": study.text,
        "parameter_files": json.dumps(files),
        **({"driver": json.dumps(asdict(driver))} if driver else {}),
        **({"servo_model": json.dumps(asdict(model))} if model else {}),
        _HASH: _hash(study),
        "code": code_identity(),
        "versions": json.dumps(versions_of(PACKAGES)),
    }


def _hash(study: Study) -> str:
    """Return a hash of a study with its points and the code."""
    return hashlib.sha256(study.identity().encode() + study.points().tobytes()).hexdigest()[:24]
