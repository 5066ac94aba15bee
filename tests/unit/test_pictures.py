# SPDX-License-Identifier: Apache-2.0
"""The figures of the pages: code draws each of them, each is small, and a page shows it."""

import runpy
from pathlib import Path

import pytest
from documented_commands import PAGES, ROOT

FOLDER = ROOT / "docs" / "figures" / "model"
GENERATOR = runpy.run_path(str(ROOT / "docs" / "generate_pictures.py"))
DRAWN = {f"{name}.png" for name in GENERATOR["PICTURES"]}


def test_the_folder_holds_what_the_generator_draws():
    assert {path.name for path in FOLDER.iterdir()} == DRAWN


@pytest.mark.parametrize("path", sorted(FOLDER.iterdir()), ids=lambda path: path.name)
def test_a_picture_is_small(path: Path):
    assert path.stat().st_size < 150_000


def test_each_picture_is_shown():
    text = "".join(page.read_text(encoding="utf-8") for page in PAGES)
    assert {name for name in DRAWN if f"figures/model/{name})" not in text} == set()


@pytest.mark.parametrize("name", ["fin_force", "cable_slack"])
def test_it_is_drawn(name: str):
    figure = GENERATOR["PICTURES"][name]()
    figure.draw_without_rendering()
    texts = {text.get_text() for axes in figure.axes for text in axes.texts}
    assert figure.axes
    assert texts
