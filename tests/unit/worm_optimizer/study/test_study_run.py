# SPDX-License-Identifier: Apache-2.0
"""Result of a study: its file, table, summary and page."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest
import xarray
import yaml
from study_cases import SMALL, Here

from worm_model.errors import InputError
from worm_optimizer.study.blocks import Counts, Workers
from worm_optimizer.study.point import compute_block
from worm_optimizer.study.study_file import parse_study
from worm_optimizer.study.study_page import write_page
from worm_optimizer.study.study_run import point_table, run_study, write_csv
from worm_optimizer.study.summary import summarise

STUDY = parse_study(SMALL, Path())


def finish(output: Path, study=STUDY) -> Counts:
    return run_study(study, output, Workers(), print, lambda done: None)


@pytest.fixture(scope="module")
def output(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("results") / "study.nc"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("worm_optimizer.study.blocks._computed", Here())
        assert finish(path) == Counts(6, 6, 3)
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
    (path.parent / "study.nc.blocks").rename(tmp_path / "gone")
    finish(path)  # Nothing is left to compute.
    assert here.pieces == 6


def test_more_samples_continue_a_study(tmp_path, here):
    def study(points: int):
        content = yaml.safe_load(SMALL.replace("[front, gaits]", "[front]"))
        content["vary"] = {"slack": {"range": [0.004, 0.012]}, "direction": [1, -1]}
        content["sample"] = {"points": points}
        return parse_study(yaml.safe_dump(content), Path())

    path = tmp_path / "study.nc"
    finish(path, study(3))
    first = xarray.load_dataset(path)["hypervolume"]
    assert (here.pieces, first.sizes["sample"]) == (6, 3)
    with pytest.raises(InputError, match="nothing is overwritten"):
        finish(path, study(5))
    path.rename(tmp_path / "three.nc")
    finish(path, study(5))
    assert here.pieces == 10
    more = xarray.load_dataset(path)
    assert np.array_equal(more["hypervolume"][:, :3], first, equal_nan=True)
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


@pytest.mark.parametrize("share", [0.0, 0.01, 0.99])
def test_a_cut_result_is_reported_and_written_again_from_its_blocks(tmp_path, here, share):
    path = tmp_path / "study.nc"
    finish(path)
    whole = path.read_bytes()
    path.write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(InputError, match=r"study\.nc: .*move it away and repeat"):
        finish(path)
    path.unlink()
    finish(path)
    assert path.read_bytes() == whole
    assert here.pieces == 6


def test_the_table_has_a_row_per_point_and_a_column_per_gait(output, tmp_path):
    data = point_table(output)
    assert data.sizes["point"] == 6
    rows = zip(data["slack"].values, data["switching_threshold"].values, strict=True)
    assert list(rows) == [tuple(row) for row in STUDY.points()[:, 1:]]
    file = tmp_path / "study.csv"
    write_csv(output, file)
    rows = list(csv.DictReader(file.open(newline="")))
    assert len(rows) == 6
    assert rows[3]["slack"] == "0.008"
    speed = xarray.load_dataset(output)["speed"]
    speed = speed.sel(slack=0.008, switching_threshold=0.0175, gait="max_speed")
    assert float(rows[3]["speed_max_speed"]) == float(speed)
    assert rows[2]["speed_max_speed"] == ""
    assert "half the pitch" in rows[2]["reason"]


@pytest.mark.parametrize(
    ("requests", "gait", "first", "goal"),
    [
        ("at_speed_m_s: 0.004", "min_power_at_speed", "power at 4 mm/s", "lowest"),
        ("at_power_W: 2.6", "max_speed_at_power", "speed at 2.6 W", "highest"),
        ("at_power_W: 2.6, at_speed_m_s: 0.004", "max_speed_at_power", "speed at 2.6 W", "highest"),
        ("direction: 1", "cruise", "cost of transport", "lowest"),
    ],
)
def test_requested_gaits_and_probabilities_are_on_the_page(
    tmp_path, here, requests, gait, first, goal
):
    text = SMALL.replace("at_power_W: 2.6", requests).replace("gaits]", "gaits, success]")
    study, path = parse_study(text, Path()), tmp_path / "study.nc"
    finish(path, study)
    found = summarise(path, study)
    assert found.figures[0].name == first
    assert goal in found.goal
    data = point_table(path).sel(gait=gait).isel(point=[1, 3, 5])
    shown = {column.name: column.values for column in found.figures}
    assert np.array_equal(shown["success probability"], data["success_probability"])
    any_phase = shown["success at unknown phase"]
    assert np.array_equal(any_phase, data["success_probability_any_phase"])
    for key, name in (("at_power_W", "speed at 2.6 W"), ("at_speed_m_s", "power at 4 mm/s")):
        assert (name in shown) == (key in requests)
    best = {"speed at 2.6 W": np.argmax, "power at 4 mm/s": np.argmin}.get(first, np.argmin)
    assert found.best == best(shown[first])
    write_page(path, study, tmp_path / "page.html")
    page = (tmp_path / "page.html").read_text()
    assert first in page
    assert "success probability" in page
    assert "less than half the pitch" in page


def test_other_files_are_left_alone(output, tmp_path):
    notes = tmp_path / "notes.txt"
    notes.write_text("mine")
    with pytest.raises(InputError, match="is no result of a study"):
        finish(notes)
    assert notes.read_text() == "mine"
    with pytest.raises(InputError, match="nothing is overwritten"):
        finish(output, parse_study(SMALL.replace("0.012", "0.011"), Path()))
    with pytest.raises(InputError, match="does not exist"):
        finish(tmp_path / "no" / "a.nc")
