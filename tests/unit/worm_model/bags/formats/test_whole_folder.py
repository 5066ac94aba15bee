# SPDX-License-Identifier: Apache-2.0
"""Folders that are complete or do not exist."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from worm_model.bags.formats.bag_errors import BagError, ExistsError
from worm_model.bags.formats.whole_folder import new_folder


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


def test_what_a_killed_process_left_is_cleared_away(tmp_path: Path):
    killed = (
        "import os, pathlib, sys\n"
        "from worm_model.bags.formats.whole_folder import new_folder\n"
        "with new_folder(pathlib.Path(sys.argv[1])) as folder:\n"
        "    (folder / 'old').write_text('half')\n"
        "    os.kill(os.getpid(), 9)\n"
    )
    end = subprocess.run(
        [sys.executable, "-c", killed, str(tmp_path / "bag")],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
        check=False,
    )
    assert end.returncode == -9
    assert (tmp_path / ".bag.unfinished" / "old").exists()
    with new_folder(tmp_path / "bag") as folder:
        (folder / "new").write_text("whole")
    assert sorted(path.name for path in (tmp_path / "bag").iterdir()) == ["new"]


def test_two_do_not_write_the_same_at_once(tmp_path: Path):
    with new_folder(tmp_path / "bag") as folder:
        (folder / "file").write_text("mine")
        with pytest.raises(BagError, match="being written by another process"):
            new_folder(tmp_path / "bag").__enter__()
    assert (tmp_path / "bag" / "file").read_text() == "mine"


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


def test_files_and_names_reach_the_disk_before_the_folder_gets_its_name(
    tmp_path: Path, monkeypatch
):
    synchronised: list[tuple[bool, str]] = []
    fsync = os.fsync

    def watched(handle: int) -> None:
        path = Path(f"/proc/self/fd/{handle}").readlink()
        synchronised.append(((tmp_path / "bag").exists(), path.name))
        fsync(handle)

    monkeypatch.setattr(os, "fsync", watched)
    with new_folder(tmp_path / "bag") as folder:
        (folder / "file").write_text("content")
    assert synchronised == [(False, "file"), (False, ".bag.unfinished"), (True, tmp_path.name)]
