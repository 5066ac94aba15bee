# SPDX-License-Identifier: Apache-2.0
"""Names that pages ask for lead to bags and reports below the bags folder and nowhere else."""

import asyncio
import sys
from pathlib import Path

import pytest

from worm_model.errors import InputError
from worm_optimizer.console import shelf as shelves
from worm_optimizer.console.shelf import Shelf, found


@pytest.fixture
def shelf(tmp_path: Path) -> Shelf:
    for place in ("bags/run", "bags/campaign/fast", "secret", "bags/run_report"):
        (tmp_path / place).mkdir(parents=True)
        (tmp_path / place / "metadata.yaml").touch()
        (tmp_path / place / "report.html").touch()
    (tmp_path / "bags/link").symlink_to(tmp_path / "secret")
    return Shelf(tmp_path / "bags")


@pytest.mark.parametrize("name", ["run", "campaign/fast", "campaign/../run"])
def test_bags_below_the_folder_are_found(shelf: Shelf, name: str):
    assert shelf.bag(name) == (shelf.folder / name).resolve()


@pytest.mark.parametrize(
    "name",
    [
        *("../secret", "/etc", "", ".", "..", "run/../../secret", "link", "none"),
        *("campaign", "run\0", "/secret", 5000 * "x"),
    ],
)
def test_nothing_else_is(shelf: Shelf, name: str):
    with pytest.raises(InputError):
        shelf.bag(name)


@pytest.mark.parametrize("name", ["run", "../secret", "link", "none_report", ""])
def test_a_page_is_only_that_of_a_report(shelf: Shelf, name: str):
    assert shelf.report("run_report").name == "report.html"
    with pytest.raises(InputError):
        shelf.report(name)


def test_a_bag_whose_links_lead_out_is_not_packed(shelf: Shelf, tmp_path: Path):
    (shelf.bag("run") / "link").symlink_to("/etc/passwd")
    with pytest.raises(InputError, match="links lead out of the bags folder"):
        asyncio.run(shelf.packed("run", tmp_path))


def test_a_folder_without_bags_has_no_rows_and_is_made(tmp_path: Path):
    assert asyncio.run(Shelf(tmp_path / "new").rows()) == []


def test_every_word_is_looked_for_in_every_row():
    rows = [
        {"name": name, "start": start, "gait": {"direction": way}, "health": "healthy", "state": ""}
        for name, start, way in (("run_1", "2026-11-21", 1), ("run_2", "2026-11-22", -1))
    ]
    assert [row["name"] for row in found(rows, "")] == ["run_1", "run_2"]
    assert [row["name"] for row in found(rows, "RUN reverse")] == ["run_2"]
    assert [row["name"] for row in found(rows, "11-21 healthy")] == ["run_1"]
    assert found(rows, "faulty") == []


SAYS_ITS_WORDS = """import sys
print("locomotion: 10%", "last", sep="\\n", file=sys.stderr)
print(" ".join(sys.argv[1:]))
sys.exit("--fail" in sys.argv)
"""


@pytest.fixture
def executables(monkeypatch: pytest.MonkeyPatch) -> None:
    command = [sys.executable, "-c", SAYS_ITS_WORDS]
    monkeypatch.setattr(shelves, "executable_command", lambda *_: command)


@pytest.mark.usefixtures("executables")
def test_what_an_executable_says_is_told_line_by_line():
    told: list[str] = []
    assert asyncio.run(shelves._run("a", "b", "x", "y", tell=told.append)) == "x y\n"
    assert told == ["locomotion: 10%", "last"]
    with pytest.raises(InputError, match="last"):
        asyncio.run(shelves._run("a", "b", "--fail"))


@pytest.mark.usefixtures("executables")
def test_an_identification_is_named_by_its_time_and_made_of_bags_alone(shelf: Shelf):
    told: list[str] = []
    made = asyncio.run(shelf.identify(["run"], "", told.append))
    assert made.startswith("identified_")
    assert "report" in told
    with pytest.raises(InputError):
        asyncio.run(shelf.identify(["run", "../secret"], "", told.append))


def test_only_what_was_identified_here_is_a_parameter_file(shelf: Shelf):
    for name in ("identified_1.yaml", "identified_2.yaml", "robot.yaml"):
        (shelf.folder / name).touch()
    assert shelf.identified() == ["identified_2.yaml", "identified_1.yaml"]
    assert shelf.parameter_file("identified_1.yaml") == str(shelf.folder / "identified_1.yaml")
    for name in ("robot.yaml", "../secret/metadata.yaml", ""):
        with pytest.raises(InputError):
            shelf.parameter_file(name)
