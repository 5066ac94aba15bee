# SPDX-License-Identifier: Apache-2.0
"""Bags and reports below the folder are found by name, files outside of it are not."""

import asyncio
import sys
from pathlib import Path

import pytest

from worm_model.errors import InputError
from worm_optimizer.console import bag_library
from worm_optimizer.console.bag_library import BagLibrary, cells_of


@pytest.fixture
def library(tmp_path: Path) -> BagLibrary:
    for place in ("bags/run", "bags/campaign/fast", "secret", "bags/run_report"):
        (tmp_path / place).mkdir(parents=True)
        (tmp_path / place / "metadata.yaml").touch()
        (tmp_path / place / "report.html").touch()
    (tmp_path / "bags/link").symlink_to(tmp_path / "secret")
    return BagLibrary(tmp_path / "bags")


@pytest.mark.parametrize("name", ["run", "campaign/fast", "campaign/../run"])
def test_bags_below_the_folder_are_found(library: BagLibrary, name: str):
    assert library.bag(name) == (library.folder / name).resolve()


@pytest.mark.parametrize(
    "name",
    [
        *("../secret", "/etc", "", ".", "..", "run/../../secret", "link", "none"),
        *("campaign", "run\0", "/secret", 5000 * "x"),
    ],
)
def test_other_files_are_not(library: BagLibrary, name: str):
    with pytest.raises(InputError):
        library.bag(name)


@pytest.mark.parametrize("name", ["run", "../secret", "link", "none_report", ""])
def test_a_page_is_only_that_of_a_report(library: BagLibrary, name: str):
    assert library.report("run_report").name == "report.html"
    with pytest.raises(InputError):
        library.report(name)


def test_a_bag_whose_links_lead_out_is_not_packed(library: BagLibrary, tmp_path: Path):
    (library.bag("run") / "link").symlink_to("/etc/passwd")
    with pytest.raises(InputError, match="links lead out of the bags folder"):
        asyncio.run(library.packed("run", tmp_path))


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


def test_a_report_has_another_name_after_a_change_of_bags_parameters_or_code(
    library: BagLibrary, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    made: list[list[str]] = []

    async def run(command: list[str], *arguments: str) -> str:
        made.append(list(arguments))
        folder = Path(arguments[arguments.index("--output") + 1])
        folder.mkdir()
        (folder / "report.html").touch()
        return ""

    monkeypatch.setattr(bag_library, "_run", run)
    parameters = tmp_path / "robot.yaml"
    parameters.write_text("a")

    def name(*bags: str, file: str = "") -> str:
        return asyncio.run(library.make_report(bags, file))

    first = name("run")
    assert name("run") == first
    assert len(made) == 1
    names = {first, name("run", "campaign/fast"), name("run", file=str(parameters))}
    parameters.write_text("b")
    names.add(name("run", file=str(parameters)))
    (library.folder / "run/metadata.yaml").write_text("another recording")
    names.add(name("run"))
    monkeypatch.setattr(bag_library, "code_identity", lambda: "another code")
    names.add(name("run"))
    assert len(names) == len(made) == 6
    assert all(library.report(each).is_file() for each in names)
