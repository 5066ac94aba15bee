# SPDX-License-Identifier: Apache-2.0
"""Run of a study: computation of the points that no stored block contains, and the NetCDF file of all results.

The file contains no time and no place of its computation: equal values result in equal bytes.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import xarray

from worm_model.checksum import versions_of
from worm_model.errors import InputError
from worm_model.parameters import format_parameter_file
from worm_optimizer.code_version import PACKAGES, code_identity
from worm_optimizer.study.blocks import Block, Say, Workers, complete, write_whole
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
from worm_optimizer.study.study_file import PARAMETER_FILE, QUANTITIES, SAMPLE, Study

STATE, REASON = "state", "reason"
_OTHER_COORDINATES = {
    PARAMETER_FILE: ("1", "parameter file of the robot"),
    SAMPLE: ("1", "number of the sample"),
    FRONT: ("1", "gait of the front, by rising speed"),
    GAIT: ("1", "gait, by its objective"),
    SCAN: ("m", "margin of the scan"),
}


def run_study(
    study: Study, output: Path, workers: Workers, say: Say, progress: Callable[[float], None]
) -> int:
    """Compute a study into the new NetCDF file ``output``, and return the number of failed points.

    If this fails, the finished blocks remain in a folder next to the output, and calling it again computes the others.

    Args:
        study: study.
        output: NetCDF file.
        workers: workers to use.
        say: function that is called with each message.
        progress: function that is called with the finished share of the points, 0 to 1.

    Raises:
        InputError: The output exists, its folder is missing, or the cluster cannot be used.
        LostError: The cluster was lost.
        OSError: The output cannot be written.
    """
    if not output.parent.is_dir():
        raise InputError(f"{output}: the folder {output.parent} does not exist; create it first")
    if output.exists():
        raise InputError(
            f"{output}: exists already, and nothing is overwritten; choose another name, or move it away"
        )
    folder = output.with_name(f"{output.name}.blocks")
    compute = partial(compute_block, study)
    blocks = complete(compute, study.blocks(), study.identity(), folder, workers, say, progress)
    results = {name: np.concatenate([block[name] for block in blocks]) for name in blocks[0]}
    content = _dataset(study, results).to_netcdf(engine="scipy", format="NETCDF3_64BIT")
    # not to a path, for which xarray takes a lock from Dask's last client, even if that one is closed
    write_whole(output, bytes(content))
    return int(np.count_nonzero(results[STATE] == FAILED))


def _dataset(study: Study, results: Block) -> xarray.Dataset:
    """Return the results of a study, in the order of its points, with names, units and provenance."""
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
        values = results[name].astype(object) if name == REASON else results[name]
        shaped = values.reshape(*study.file.shape, *values.shape[1:])
        data[name] = ((*study.file.dimensions, *further), shaped, attributes)
    used = {name for further, _ in described.values() for name in further}
    return xarray.Dataset(data, _coordinates(study, used), _provenance(study))


def _coordinates(study: Study, used: set[str]) -> dict[str, Any]:
    """Return all coordinates: the points, the fixed quantities as scalars, and the further dimensions ``used``."""
    file = study.file
    names = np.array([name for name, _ in study.robots], dtype=object)
    values: dict[str, Any] = {PARAMETER_FILE: ((), names[0])}
    values |= {name: ((), value) for name, value in file.fixed.items()}
    values |= {name: (name, np.asarray(each)) for name, each in file.dimensions.items()}
    if len(names) > 1:
        values[PARAMETER_FILE] = (PARAMETER_FILE, names)
    samples = study.points()[: file.shape[-1]]
    for name in file.ranges:
        values[name] = (SAMPLE, samples[:, study.varied.index(name)])
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
    files = {name: format_parameter_file(content) for name, content in study.robots}
    return {
        "Conventions": "CF-1.11",
        "title": study.file.title,
        "study": study.text,
        "parameter_files": json.dumps(files),
        "code": code_identity(),
        "versions": json.dumps(versions_of(PACKAGES)),
    }
