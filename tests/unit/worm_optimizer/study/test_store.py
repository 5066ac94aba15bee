# SPDX-License-Identifier: Apache-2.0
import errno
import json
import random
import subprocess
import sys
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import xarray
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from study_cases import SMALL, contents

from worm_optimizer.study import store as store_module
from worm_optimizer.study.point import Results, compute_block
from worm_optimizer.study.store import (
    StoreError,
    block_shape,
    chunk_shape,
    existing_store,
    locked_store,
    regions,
    stored_study,
)
from worm_optimizer.study.study_file import identity_of, parse_study

STUDY = parse_study(SMALL, Path())
SECOND = (slice(0, 1), slice(1, 2))


@cache
def computed(text: str, points: bytes) -> Results:
    """Return the results of a block, computed once for all tests."""
    study = parse_study(text, Path())
    return compute_block(study, np.frombuffer(points).reshape(-1, len(study.varied)))


def finish(path: Path, most: int = 1000, study=STUDY) -> int:
    """Compute at most this number of open blocks here, and return the number of damaged ones."""
    with locked_store(path, study) as store:
        audit = store.audit()
        store.reset(audit)
        for block in [*audit.unfinished, *audit.damaged][:most]:
            store.write(block, computed(study.text, store.points[block].tobytes()))
        return len(audit.damaged)


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("whole") / "study.zarr"
    finish(path)
    return path


@pytest.fixture(scope="module")
def data_of_whole(whole) -> xarray.Dataset:
    with xarray.open_zarr(whole) as data:
        return data.load()


def copy_of(whole: Path, folder: Path) -> Path:
    path = folder / "study.zarr"
    subprocess.run(["cp", "-r", str(whole), str(path)], check=True)
    return path


def test_an_interrupted_and_resumed_study_has_the_same_bytes(whole, tmp_path):
    for _ in range(7):
        finish(tmp_path / "parts.zarr", most=1)
    assert contents(tmp_path / "parts.zarr") == contents(whole)


def test_a_file_that_was_being_written_when_a_process_was_killed_is_removed(whole, tmp_path):
    path = copy_of(whole, tmp_path)
    (path / "speed" / "0.0a1b.partial").write_bytes(b"half a chunk")
    finish(path)
    assert contents(path) == contents(whole)


@given(
    shape=st.lists(st.integers(1, 40), min_size=1, max_size=4),
    points=st.integers(1, 50),
)
def test_blocks_and_chunks_cover_the_points_once(shape, points):
    names = ("slack", "clearance", "margin_m", "rear_mass")
    vary = {
        name: np.linspace(0.002, 0.1, size).tolist()
        for size, name in zip(shape, names, strict=False)
    }
    text = yaml.safe_dump({"vary": vary, "compute": ["cliff"], "block_points": points})
    study = parse_study(text, Path())
    block = block_shape(study)
    assert np.prod(block) <= points
    for part in (block, chunk_shape(study, block)):
        count = np.zeros(study.shape, int)
        for region in regions(study.shape, part):
            count[region] += 1
        assert np.all(count == 1)
    chunk = chunk_shape(study, block)
    assert all(
        large % small == 0 for large, small in zip(chunk, block, strict=True)
    )  # no block is in two chunks


def test_a_block_without_its_checksum_is_computed_again(whole, tmp_path):
    path = copy_of(whole, tmp_path)
    with locked_store(path, STUDY) as store:
        store._group("r+")["block_checksum"][SECOND] = 0
        audit = store.audit()
        assert (audit.unfinished, audit.damaged) == ([SECOND], [])
        assert store.counts() == (5, 3)
    assert finish(path) == 0
    assert contents(path) == contents(whole)


def results_of(path: Path, data: xarray.Dataset) -> list[Path]:
    """Return the files of a store that contain the variables of its data."""
    return sorted(
        file
        for file in path.rglob("*")
        if file.is_file() and not file.name.startswith(".") and file.parent.name in data.data_vars
    )


LOST = (
    *(".zmetadata", "speed/.zarray", "speed/.zattrs", "slack/0", "slack/.zarray"),
    *("speed/0.0.0", "groove_phase/0.0", "reason/0.0", "state/0.0", "block_checksum/0.0"),
)


@pytest.mark.parametrize("name", LOST)
def test_a_lost_file_is_detected_and_restored(whole, tmp_path, name):
    path = copy_of(whole, tmp_path)
    (path / name).unlink()
    finish(path)
    assert contents(path) == contents(whole)


@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_no_flipped_bit_changes_a_value(whole, data_of_whole, tmp_path_factory, seed):
    path = copy_of(whole, tmp_path_factory.mktemp("flipped"))
    draw = random.Random(seed)
    file = draw.choice(results_of(path, data_of_whole))
    data = bytearray(file.read_bytes())
    data[draw.randrange(len(data))] ^= 1 << draw.randrange(8)
    file.write_bytes(data)
    finish(path)
    # The bytes may differ: a compressed block has bits without a meaning.
    with xarray.open_zarr(path) as found:
        assert found.load().identical(data_of_whole)


def test_swapped_values_are_damage(whole, tmp_path):
    path = copy_of(whole, tmp_path)
    with locked_store(path, STUDY) as store:
        speed = store._group("r+")["speed"]
        values = speed[:]
        values[:, 1] = values[::-1, 1]
        speed[:] = values
        assert len(store.audit().damaged) == 2  # the middle one remains
    assert finish(path) == 2
    assert contents(path) == contents(whole)


def test_a_changed_coordinate_is_restored_and_reported(whole, tmp_path):
    path = copy_of(whole, tmp_path)
    (path / "slack" / "0").write_bytes((path / "switching_threshold" / "0").read_bytes())
    with locked_store(path, STUDY) as store:
        assert store.repaired == ("slack/0",)
    assert contents(path) == contents(whole)


def test_more_samples_continue_a_study(tmp_path):
    def study(points: int):
        content = yaml.safe_load(SMALL.replace("[front, gaits]", "[front]"))
        content["vary"] = {"slack": {"range": [0.004, 0.012]}, "direction": [1, -1]}
        content["sample"] = {"points": points}
        return parse_study(yaml.safe_dump({**content, "block_points": 2}), Path())

    path = tmp_path / "study.zarr"
    finish(path, study=study(3))
    with xarray.open_zarr(path) as data:
        before = data["hypervolume"].load()
    assert before.sizes["sample"] == 3
    with locked_store(path, study(5)) as store:
        assert store.repaired == ()
        audit = store.audit()
        assert audit.damaged == []
        # Of the first three samples only the block at the end, which was smaller, is computed again.
        assert sorted({block[1].start for block in audit.unfinished}) == [2, 4]
    finish(path, study=study(5))
    with xarray.open_zarr(path) as data:
        assert data["hypervolume"].sizes["sample"] == 5
        assert np.array_equal(data["hypervolume"][:, :3], before, equal_nan=True)
        assert np.all(data["state"] == 1)
    finish(tmp_path / "fresh.zarr", study=study(5))
    assert contents(path) == contents(tmp_path / "fresh.zarr")
    with pytest.raises(StoreError, match="another study"), locked_store(path, study(4)):
        pass


def test_a_store_describes_its_study(whole):
    study = stored_study(whole)
    assert identity_of(study) == identity_of(STUDY)
    assert study.files[0][1].parameters == STUDY.files[0][1].parameters
    with existing_store(whole) as store:
        assert store.counts() == (6, 3)
        assert store.audit().damaged == []


def test_a_full_disk_leaves_the_finished_blocks(whole, tmp_path, monkeypatch):
    path = tmp_path / "study.zarr"
    finish(path, most=2)

    class Full:
        """Group whose disk has room for three more arrays."""

        def __init__(self, group):
            self.group, self.room = group, 3

        def __getitem__(self, name):
            return self

        def __setitem__(self, name, value):
            self.room -= 1
            if self.room < 0:
                raise OSError(errno.ENOSPC, "No space left on device")

    with locked_store(path, STUDY) as store:
        block = store.audit().unfinished[0]
        results = compute_block(STUDY, store.points[block].reshape(1, -1))
        real = store_module.Store._group
        monkeypatch.setattr(store_module.Store, "_group", lambda self, mode: Full(real(self, mode)))
        with pytest.raises(OSError, match="No space left"):
            store.write(block, results)
        monkeypatch.undo()
        assert store.counts()[0] == 2
    finish(path)
    assert contents(path) == contents(whole)


def test_two_clients_on_one_output_are_rejected(tmp_path):
    path = tmp_path / "study.zarr"
    code = (
        "import sys; from pathlib import Path\n"
        "from worm_optimizer.study.study_file import parse_study\n"
        "from worm_optimizer.study.store import StoreError, locked_store\n"
        "path, study = Path(sys.argv[1]), parse_study(sys.argv[2], Path())\n"
        "def attempt():\n"
        "    try:\n"
        "        with locked_store(path, study): print('locked', flush=True)\n"
        "    except StoreError as error: print(error, flush=True)\n"
        "attempt(); sys.stdin.readline(); attempt()\n"
    )
    other = subprocess.Popen(
        [sys.executable, "-c", code, str(path), SMALL],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    with other:
        with locked_store(path, STUDY):
            assert other.stdout is not None
            assert "another process works on it" in other.stdout.readline()
        assert other.communicate("again\n") == ("locked\n", None)


def test_another_study_another_code_and_other_files_are_left_alone(whole, tmp_path, monkeypatch):
    path = copy_of(whole, tmp_path)
    different = parse_study(SMALL.replace("0.012", "0.011"), Path())
    with (
        pytest.raises(StoreError, match="another study \\(small\\)"),
        locked_store(path, different),
    ):
        pass
    monkeypatch.setattr(store_module, "identity", lambda: "other code")
    with (
        pytest.raises(StoreError, match="was begun by another version"),
        locked_store(path, STUDY),
    ):
        pass
    assert contents(path) == contents(whole)
    notes = tmp_path / "notes.txt"
    notes.write_text("mine")
    for used in (notes, tmp_path):
        with pytest.raises(StoreError, match="nothing is overwritten"), locked_store(used, STUDY):
            pass
    assert notes.read_text() == "mine"
    with (
        pytest.raises(StoreError, match="does not exist"),
        locked_store(tmp_path / "no" / "a.zarr", STUDY),
    ):
        pass


def test_a_study_of_an_earlier_version_is_named_so(tmp_path):
    old = {"study": "vary: {}", "study_hash": "0", "code": "1", "title": "old"}
    (tmp_path / ".zgroup").write_text('{"zarr_format": 2}')
    (tmp_path / ".zattrs").write_text(json.dumps(old))
    with pytest.raises(StoreError, match="earlier version"), locked_store(tmp_path, STUDY):
        pass


def test_a_damaged_description_is_reported_as_such(tmp_path):
    (tmp_path / ".zgroup").write_text('{"zarr_format": 2}')
    (tmp_path / ".zattrs").write_text("{")
    with pytest.raises(StoreError, match="damaged"), locked_store(tmp_path, STUDY):
        pass


def test_a_store_that_cannot_be_created_is_reported_with_the_reason(tmp_path, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Path, "rename", full)
    with (
        pytest.raises(StoreError, match="No space left"),
        locked_store(tmp_path / "study.zarr", STUDY),
    ):
        pass


def test_the_result_opens_with_names_units_and_provenance(tmp_path):
    path = tmp_path / "study.zarr"
    finish(path, most=2)
    with xarray.open_zarr(path) as data:
        assert data["speed"].dims == ("slack", "switching_threshold", "gait")
        assert data["speed"].attrs["units"] == "m/s"
        for name, coordinate in data.coords.items():
            assert {"units", "long_name"} <= set(coordinate.attrs), name
        assert data["margin_m"].shape == ()
        assert data["margin_m"] == 0.002
        assert data["gait"].values.tolist()[1] == "cruise"
        assert data["state"].values.tolist() == [[2, 1], [0, 0], [0, 0]]
        assert data["state"].attrs["flag_values"] == [0, 1, 2]
        assert len(data["state"].attrs["flag_meanings"].split()) == 3
        assert data["reason"].dtype.kind in "OT"
        assert "less than half the pitch" in str(data["reason"].values[0, 0])
        assert data["reason"].values[0, 1] == ""
        assert np.isnan(data["speed"].values[1:]).all()
        assert data.attrs["Conventions"].startswith("CF-")
        assert data.attrs["study_hash"] == identity_of(STUDY)
        assert {"numpy", "numba", "python", "worm_model"} <= set(json.loads(data.attrs["versions"]))
        assert data.attrs["study_file"] == SMALL
        one = compute_block(STUDY, STUDY.points()[SECOND].reshape(1, -1))
        front = data["front_power"].sel(slack=0.004, switching_threshold=0.0175)
        assert np.array_equal(front, one["front_power"][0], equal_nan=True)


def test_a_large_study_has_few_files(tmp_path):
    vary = {"slack": {"from": 0.0, "to": 0.012, "count": 2048}}
    content = {**yaml.safe_load(SMALL), "vary": vary, "block_points": 64}
    study = parse_study(yaml.safe_dump(content), Path())
    results = compute_block(STUDY, STUDY.points()[SECOND].reshape(1, -1))
    rows = {name: np.repeat(values, 64, axis=0) for name, values in results.items()}
    with locked_store(tmp_path / "study.zarr", study) as store:
        for block in store.blocks():
            store.write(block, rows)
        assert store.counts() == (2048, 0)
    assert len(contents(tmp_path / "study.zarr")) < 150
