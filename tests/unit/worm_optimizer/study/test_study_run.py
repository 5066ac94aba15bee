# SPDX-License-Identifier: Apache-2.0
"""Result of a study: its file."""

import json
from pathlib import Path

import numpy as np
import pytest
import xarray
from study_cases import SMALL, Here, small_study

from worm_model.errors import InputError
from worm_optimizer.study.blocks import Workers
from worm_optimizer.study.point import compute_block
from worm_optimizer.study.study_run import run_study

STUDY = small_study()


def finish(output: Path, study=STUDY) -> int:
    return run_study(study, output, Workers(), print, lambda done: None)


@pytest.fixture(scope="module")
def output(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("results") / "study.nc"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("worm_optimizer.study.blocks._computed", Here())
        assert finish(path) == 3
    return path


def test_a_study_killed_after_each_block_has_the_same_bytes(output, tmp_path, here):
    path = tmp_path / "study.nc"
    for most in range(1, 6):
        here.most = most
        with pytest.raises(KeyboardInterrupt):
            finish(path)
        assert not path.exists()
    here.most = 6
    finish(path)
    assert path.read_bytes() == output.read_bytes()
    with pytest.raises(InputError, match="nothing is overwritten"):
        finish(path)
    path.unlink()
    finish(path)  # from its blocks
    assert here.pieces == 6


def test_more_samples_continue_a_study(tmp_path, here):
    def study(points: int):
        vary = {"slack": {"range": [0.004, 0.012]}, "direction": [1, -1]}
        return small_study(compute=["front"], vary=vary, sample={"points": points})

    path = tmp_path / "study.nc"
    finish(path, study(3))
    first = xarray.load_dataset(path)["front_power"]
    assert (here.pieces, first.sizes["sample"]) == (6, 3)
    path.rename(tmp_path / "three.nc")
    finish(path, study(5))
    assert here.pieces == 10
    more = xarray.load_dataset(path)
    assert np.array_equal(more["front_power"][:, :3], first, equal_nan=True)
    assert np.all(more["state"] == 1)


def test_the_result_opens_with_names_units_and_provenance(output):
    with xarray.open_dataset(output) as data:
        assert data["speed"].dims == ("slack", "switching_threshold", "gait")
        for name, variable in data.variables.items():
            assert "long_name" in variable.attrs, name
            assert "units" in variable.attrs or name in ("state", "reason"), name
        assert data["speed"].attrs["units"] == "m/s"
        assert data["margin_m"].shape == ()
        assert data["margin_m"] == 0.002
        assert data["gait"].values.tolist()[1] == "cruise"
        assert data["state"].values.tolist() == [[2, 1]] * 3
        assert data["state"].attrs["flag_values"].dtype == data["state"].dtype
        assert "less than half the pitch" in str(data["reason"].values[0, 0])
        assert data["reason"].values[0, 1] == ""
        assert np.isnan(data["speed"].values[:, 0]).all()
        assert data.attrs["Conventions"].startswith("CF-")
        assert {"numpy", "numba", "python", "worm_model"} <= set(json.loads(data.attrs["versions"]))
        assert data.attrs["study"] == SMALL
        assert "slack" in json.loads(data.attrs["parameter_files"])["the paper"]
        one = compute_block(STUDY, STUDY.points()[1:2])
        front = data["front_power"].sel(slack=0.004, switching_threshold=0.0175)
        assert np.array_equal(front, one["front_power"][0], equal_nan=True)
