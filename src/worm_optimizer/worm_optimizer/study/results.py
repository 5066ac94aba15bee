# SPDX-License-Identifier: Apache-2.0
"""Results of a study as a table with a row per point, and as NetCDF and CSV files."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import numpy as np
import xarray

from worm_model.errors import InputError
from worm_optimizer.study.point import FRONT, GAIT, SCAN
from worm_optimizer.study.store import CHECKSUM, STATE, open_result


@contextlib.contextmanager
def point_table(path: Path) -> Iterator[xarray.Dataset]:
    """Open the results of a study as a dataset with one dimension ``point`` instead of all dimensions of the points."""
    with open_result(path) as data:
        yield data.stack(point=data[STATE].dims).reset_index("point")


def check_export(file: Path) -> None:
    """Check that the suffix of a file belongs to a known format.

    Raises:
        InputError: The suffix is unknown.
    """
    if file.suffix not in _WRITERS:
        raise InputError(f"{file}: the suffix is none of {', '.join(_WRITERS)}")


def export(path: Path, file: Path) -> None:
    """Write the results of a study to a file, whose suffix determines the format.

    Raises:
        InputError: The suffix is unknown.
    """
    check_export(file)
    _WRITERS[file.suffix](path, file)


def _write_netcdf(path: Path, file: Path) -> None:
    """Write all variables except the checksums, with their attributes, as NetCDF 3 (64-bit offset)."""
    with open_result(path) as data:
        plain = data.drop_vars(CHECKSUM).load()
    for name, variable in plain.variables.items():
        if variable.dtype.kind in "OT":
            plain[name] = plain[name].astype(object)
    flags = plain[STATE].attrs
    flags["flag_values"] = np.array(flags["flag_values"], plain[STATE].dtype)
    plain.to_netcdf(file, engine="scipy", format="NETCDF3_64BIT")


def _write_csv(path: Path, file: Path) -> None:
    """Write a row for each point, without fronts and margin scans.

    Each result of a gait becomes one column per gait. The name of the column ends with the name of the gait.
    """
    with point_table(path) as data:
        along = [name for name in (FRONT, SCAN) if name in data.dims]
        plain = data.drop_dims(along).drop_vars(CHECKSUM).load()
    if GAIT in plain.dims:
        of_gaits = [name for name in plain.data_vars if GAIT in plain[name].dims]
        for gait in plain[GAIT].values:
            columns = plain[of_gaits].sel({GAIT: gait}, drop=True)
            plain = plain.assign({f"{name}_{gait}": columns[name] for name in of_gaits})
        plain = plain.drop_dims(GAIT)
    frame = plain.to_dataframe()
    frame[[*plain.coords, *plain.data_vars]].to_csv(file, index=False)


_WRITERS: Mapping[str, Callable[[Path, Path], None]] = {".nc": _write_netcdf, ".csv": _write_csv}
