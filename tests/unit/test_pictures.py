# SPDX-License-Identifier: Apache-2.0
"""The figures of the pages: code draws each of them, each is small, and a page shows it."""

import runpy

import pytest
from documented_commands import PAGES, ROOT

FOLDER = ROOT / "docs" / "figures" / "model"
GENERATOR = runpy.run_path(str(ROOT / "docs" / "generate_pictures.py"))
DRAWN = {f"{name}.png" for name in GENERATOR["PICTURES"]}


def test_the_folder_holds_what_the_generator_draws_in_small_files_which_are_shown():
    assert {path.name for path in FOLDER.iterdir()} == DRAWN
    assert max(path.stat().st_size for path in FOLDER.iterdir()) < 150_000
    text = "".join(page.read_text(encoding="utf-8") for page in PAGES)
    assert {name for name in DRAWN if f"figures/model/{name})" not in text} == set()


@pytest.mark.parametrize("name", ["fin_force", "cable_slack"])
def test_it_is_drawn(name: str):
    figure = GENERATOR["PICTURES"][name]()
    figure.draw_without_rendering()
    texts = {text.get_text() for axes in figure.axes for text in axes.texts}
    assert figure.axes
    assert texts
