# SPDX-License-Identifier: Apache-2.0
import csv
from pathlib import Path

import numpy as np
import pytest
import xarray
from study_cases import SMALL

from worm_model.errors import InputError
from worm_model.parameters import PAPER
from worm_optimizer.study import summary
from worm_optimizer.study.point import compute_block
from worm_optimizer.study.results import export, point_table
from worm_optimizer.study.store import locked_store
from worm_optimizer.study.study_file import parse_study
from worm_optimizer.study.summary import Column

STUDY = parse_study(SMALL, Path())


@pytest.fixture(scope="module")
def output(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("results") / "study.zarr"
    with locked_store(path, STUDY) as store:
        for block in store.blocks():
            store.write(block, compute_block(STUDY, store.points[block].reshape(1, -1)))
    return path


def test_the_table_has_a_row_per_point(output):
    with point_table(output) as data:
        assert data.sizes["point"] == 6
        rows = zip(data["slack"].values, data["switching_threshold"].values, strict=True)
        assert list(rows) == [tuple(row) for row in STUDY.points().reshape(6, 3)[:, 1:]]


def test_netcdf_contains_all_variables_with_units(output, tmp_path):
    file = tmp_path / "study.nc"
    export(output, file)
    with xarray.open_dataset(file, engine="scipy") as data, xarray.open_zarr(output) as store:
        assert set(store.variables) - set(data.variables) == {"block_checksum"}
        assert data["speed"].attrs["units"] == "m/s"
        assert data["state"].attrs["flag_values"].dtype == data["state"].dtype
        assert "half the pitch" in str(data["reason"].values[0, 0])
        assert np.array_equal(data["speed"], store["speed"], equal_nan=True)
        assert np.array_equal(
            data["speed"].sel(slack=0.008, gait="cruise"),
            store["speed"].sel(slack=0.008, gait="cruise"),
            equal_nan=True,
        )


def test_csv_has_a_row_per_point_and_a_column_per_gait(output, tmp_path):
    file = tmp_path / "study.csv"
    export(output, file)
    rows = list(csv.DictReader(file.open(newline="")))
    assert len(rows) == 6
    assert rows[3]["slack"] == "0.008"
    with xarray.open_zarr(output) as store:
        speed = store["speed"].sel(slack=0.008, switching_threshold=0.0175, gait="max_speed")
        assert float(rows[3]["speed_max_speed"]) == float(speed)
    assert rows[2]["speed_max_speed"] == ""
    assert "half the pitch" in rows[2]["reason"]


def test_another_format_is_rejected(output, tmp_path):
    with pytest.raises(InputError, match=r"none of \.nc, \.csv"):
        export(output, tmp_path / "study.xlsx")


@pytest.mark.parametrize(
    ("fixed", "found"),
    [
        ("margin_m: 0.002", True),
        ("margin_m: 0.002, slope_deg: 0.0", True),
        ("margin_m: 0.002, slope_deg: 10.0", False),
        ("margin_m: 0.002, bellows_stiffness: 500.0", False),
        ("margin_m: 0.002, groove_phase_m: 0.001", False),
    ],
)
def test_another_robot_is_not_taken_for_that_of_the_parameter_file(fixed, found):
    study = parse_study(SMALL.replace("margin_m: 0.002", fixed), Path())
    varied = (
        Column("slack", "m", np.array([0.004, PAPER.slack])),
        Column("switching_threshold", "m", np.full(2, PAPER.switching_threshold)),
    )
    assert summary._own(varied, study) == (1 if found else None)
