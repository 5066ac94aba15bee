# SPDX-License-Identifier: Apache-2.0
"""Folders that are complete or do not exist."""

from pathlib import Path

import pytest

from worm_model.bags.formats.bag_errors import ExistsError
from worm_model.bags.formats.bag_writer import new_folder


def test_the_folder_is_there_once_it_is_whole(tmp_path: Path):
    target = tmp_path / "deep" / "bag"
    with new_folder(target) as folder:
        (folder / "file").write_text("content")
        assert not target.exists()
    assert (target / "file").read_text() == "content"
    assert [path.name for path in target.parent.iterdir()] == ["bag"]


def test_nothing_is_left_after_an_exception(tmp_path: Path):
    def interrupted() -> None:
        with new_folder(tmp_path / "bag") as folder:
            (folder / "file").write_text("content")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert list(tmp_path.iterdir()) == []


def test_what_exists_is_not_overwritten(tmp_path: Path):
    (tmp_path / "bag").mkdir()
    with pytest.raises(ExistsError, match="exists already"):
        new_folder(tmp_path / "bag").__enter__()


def test_what_was_made_meanwhile_is_not_overwritten(tmp_path: Path):
    def too_late() -> None:
        with new_folder(tmp_path / "bag") as folder:
            (folder / "file").write_text("late")
            (tmp_path / "bag").mkdir()
            (tmp_path / "bag" / "file").write_text("early")

    with pytest.raises(ExistsError, match="meanwhile"):
        too_late()
    assert (tmp_path / "bag" / "file").read_text() == "early"
