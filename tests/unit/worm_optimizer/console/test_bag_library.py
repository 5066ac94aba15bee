# SPDX-License-Identifier: Apache-2.0
"""Bags and reports below the folder are found by name, files outside of it are not."""

import asyncio
import sys
import zipfile
from pathlib import Path

import pytest

from worm_model.errors import InputError
from worm_optimizer.console import bag_library
from worm_optimizer.console.bag_library import BagLibrary, cells_of


@pytest.fixture
def library(tmp_path: Path) -> BagLibrary:
    for place in ("bags/run", "bags/campaign/fast", "secret"):
        (tmp_path / place).mkdir(parents=True)
        (tmp_path / place / "metadata.yaml").touch()
    (tmp_path / "bags/link").symlink_to(tmp_path / "secret")
    return BagLibrary(tmp_path / "bags")


@pytest.mark.parametrize("name", ["run", "campaign/fast", "campaign/../run"])
def test_bags_below_the_folder_are_found(library: BagLibrary, name: str):
    assert library.bag(name) == (library.folder / name).resolve()


@pytest.mark.parametrize(
    "name",
    ["../secret", "/etc", "", "..", "run/../../secret", "link", "none", "campaign", "/secret"],
)
def test_other_files_are_not(library: BagLibrary, name: str):
    for find in (library.bag, library.report):
        with pytest.raises(InputError):
            find(name)


def test_a_bag_is_packed_as_a_file_with_its_name(library: BagLibrary):
    packed = asyncio.run(library.packed("campaign/fast"))
    assert packed.name == "fast.zip"
    with zipfile.ZipFile(packed) as content:
        assert "fast/metadata.yaml" in content.namelist()


def test_a_bag_whose_links_lead_out_is_not_packed(library: BagLibrary):
    (library.bag("run") / "link").symlink_to("/etc/passwd")
    with pytest.raises(InputError, match="links lead out of the bags folder"):
        asyncio.run(library.packed("run"))


def test_a_missing_folder_is_created_and_has_no_rows(tmp_path: Path):
    assert asyncio.run(BagLibrary(tmp_path / "new").rows()) == []


def test_a_list_has_rounded_numbers_and_the_state_of_a_bag_without_health():
    row = {"name": "run_1", "start": None, "gait": None, "health": None, "state": "damaged"}
    cells = cells_of({**row, "speed": 0.0034567, "power": float("nan"), "cycles": 5})
    assert (cells["speed"], cells["power"], cells["cycles"]) == (3.46, None, 5)
    assert (cells["gait"], cells["health"]) == (None, "damaged")


def test_the_last_line_of_a_process_that_fails_is_the_error():
    command = [sys.executable, "-c", "import sys; print(sys.argv[1]); sys.exit('first\\nlast')"]
    with pytest.raises(InputError, match=r"^last$"):
        asyncio.run(bag_library._run(command, "x"))
