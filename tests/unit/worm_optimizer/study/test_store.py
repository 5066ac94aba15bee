# SPDX-License-Identifier: Apache-2.0
import errno
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import xarray
from study_cases import SMALL, contents

from worm_optimizer.study import store as store_module
from worm_optimizer.study.plan import parse_study
from worm_optimizer.study.point import compute_block
from worm_optimizer.study.store import StoreError, held, open_result

STUDY = parse_study(SMALL, Path())
POINTS = STUDY.points()


def finish(path: Path, most: int = 1000) -> None:
    """Computes at most so many open blocks here."""
    with held(path, STUDY) as store:
        for block in store.open_blocks()[:most]:
            store.write(block, compute_block(STUDY, POINTS[block]))


def test_what_is_interrupted_and_resumed_has_the_same_bytes(tmp_path):
    finish(tmp_path / "whole.zarr")
    for _ in range(7):
        finish(tmp_path / "parts.zarr", most=1)
    assert contents(tmp_path / "parts.zarr") == contents(tmp_path / "whole.zarr")


def test_a_block_without_its_state_is_computed_again(tmp_path):
    path = tmp_path / "study.zarr"
    finish(path)
    whole = contents(path)
    with held(path, STUDY) as store:
        store.write(slice(1, 2), {"state": np.zeros(1, dtype=np.uint8)})
        assert store.open_blocks() == [slice(1, 2)]
        assert store.counts() == (5, 3)
    finish(path)
    assert contents(path) == whole


def test_a_full_disk_leaves_what_was_finished(tmp_path, monkeypatch):
    path = tmp_path / "study.zarr"
    finish(tmp_path / "whole.zarr")
    finish(path, most=2)

    class Full:
        """A group whose disk takes one array more."""

        def __init__(self, group):
            self.group, self.room = group, 3

        def __getitem__(self, name):
            return self

        def __setitem__(self, name, value):
            self.room -= 1
            if self.room < 0:
                raise OSError(errno.ENOSPC, "No space left on device")

    with held(path, STUDY) as store:
        real = store_module.Store._group
        monkeypatch.setattr(store_module.Store, "_group", lambda self, mode: Full(real(self, mode)))
        with pytest.raises(OSError, match="No space left"):
            store.write(slice(2, 3), compute_block(STUDY, POINTS[2:3]))
        monkeypatch.undo()
        assert store.counts()[0] == 2
    finish(path)
    assert contents(path) == contents(tmp_path / "whole.zarr")


def test_two_clients_on_one_output_are_refused(tmp_path):
    path = tmp_path / "study.zarr"
    code = (
        "import sys; from pathlib import Path\n"
        "from worm_optimizer.study.plan import parse_study\n"
        "from worm_optimizer.study.store import StoreError, held\n"
        "try:\n"
        "    with held(Path(sys.argv[1]), parse_study(sys.argv[2], Path())): print('held')\n"
        "except StoreError as error: print(error)\n"
    )

    def other() -> str:
        command = [sys.executable, "-c", code, str(path), SMALL]
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout

    with held(path, STUDY):
        assert "another process works on it" in other()
    assert other() == "held\n"


def test_another_study_another_code_and_other_files_are_left_alone(tmp_path, monkeypatch):
    path = tmp_path / "study.zarr"
    finish(path, most=1)
    before = contents(path)
    different = parse_study(SMALL.replace("0.012", "0.011"), Path())
    with pytest.raises(StoreError, match="holds another study \\(small\\)"), held(path, different):
        pass
    monkeypatch.setattr(store_module, "identity", lambda: "other code")
    with pytest.raises(StoreError, match="was begun by another version"), held(path, STUDY):
        pass
    assert contents(path) == before
    notes = tmp_path / "notes.txt"
    notes.write_text("mine")
    for taken in (notes, tmp_path):
        with pytest.raises(StoreError, match="exists already and is no study"), held(taken, STUDY):
            pass
    assert notes.read_text() == "mine"
    with pytest.raises(StoreError, match="make it first"), held(tmp_path / "no" / "a.zarr", STUDY):
        pass


def test_the_result_opens_with_names_units_and_provenance(tmp_path):
    path = tmp_path / "study.zarr"
    finish(path, most=2)
    with xarray.open_zarr(path) as data:
        assert data["speed"].dims == ("point", "gait")
        assert data["speed"].attrs["units"] == "m/s"
        assert data["slack"].attrs["units"] == "m"
        assert data["gait"].values.tolist()[1] == "cruise"
        assert data["state"].values.tolist() == [2, 1, 0, 0, 0, 0]
        assert "less than half the pitch" in str(data["reason"].values[0])
        assert data["reason"].values[1] == ""
        assert np.isnan(data["speed"].values[2:]).all()
        assert data.attrs["study_hash"] == STUDY.identity
        assert {"numpy", "numba", "python", "worm_model"} <= set(json.loads(data.attrs["versions"]))
        assert data.attrs["study"] == SMALL
        one = compute_block(STUDY, POINTS[1:2])
        assert np.array_equal(data["front_power"].values[1], one["front_power"][0], equal_nan=True)
    with open_result(path) as data:  # two quantities as a table
        table = data.set_index(point=["slack", "switching_threshold"]).unstack("point")
        assert table["speed"].sel(slack=0.004, switching_threshold=0.0175, gait="cruise") > 0.0
