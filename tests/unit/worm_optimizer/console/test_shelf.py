# SPDX-License-Identifier: Apache-2.0
"""Names that pages ask for lead to bags and reports below the bags folder and nowhere else."""

from pathlib import Path

import pytest

from worm_model.errors import InputError
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


def test_a_folder_without_bags_has_no_rows_and_is_made(tmp_path: Path):
    import asyncio

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
