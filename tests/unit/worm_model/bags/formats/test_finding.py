# SPDX-License-Identifier: Apache-2.0
"""Bags below a folder, found by names alone."""

from pathlib import Path

from worm_model.bags.formats.finding import bags_below


def made(folder: Path, *names: str) -> None:
    for name in names:
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()


def test_a_folder_a_killed_recorders_folder_and_a_file_are_bags(tmp_path: Path):
    made(tmp_path, "a/closed/metadata.yaml", "a/closed/x.mcap", "killed/killed_0.mcap")
    made(tmp_path, "killed/killed_1.mcap", "loose/one.mcap", "loose/two.db3", "loose/notes.txt")
    names = ["a/closed", "killed", "loose/one.mcap", "loose/two.db3"]
    assert bags_below(tmp_path) == [tmp_path / name for name in names]
    for bag in ("a/closed", "loose/one.mcap"):
        assert bags_below(tmp_path / bag) == [tmp_path / bag]
