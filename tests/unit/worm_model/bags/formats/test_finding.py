# SPDX-License-Identifier: Apache-2.0
"""Bags below a folder, found by names alone."""

from pathlib import Path

import pytest

from worm_model.bags.formats.finding import bags_below, recovered_path
from worm_model.errors import InputError


def made(folder: Path, *names: str) -> None:
    for name in names:
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()


def below(folder: Path) -> dict[str, list[str]]:
    found = bags_below(folder)
    return {
        str(bag.relative_to(folder)): [copy.name for copy in copies]
        for bag, copies in found.items()
    }


def test_a_folder_a_killed_recorders_folder_and_a_file_are_bags(tmp_path: Path):
    made(tmp_path, "a/closed/metadata.yaml", "a/closed/x.mcap", "killed/killed_0.mcap")
    made(tmp_path, "killed/killed_1.mcap", "loose/one.mcap", "loose/two.db3", "loose/notes.txt")
    assert list(below(tmp_path)) == ["a/closed", "killed", "loose/one.mcap", "loose/two.db3"]
    for bag in ("a/closed", "loose/one.mcap"):
        assert list(bags_below(tmp_path / bag)) == [tmp_path / bag]


@pytest.mark.parametrize("bag", ["run/metadata.yaml", "run.mcap"])
def test_what_was_recovered_belongs_to_its_source_the_last_one_last(tmp_path: Path, bag: str):
    made(tmp_path, bag, "other/metadata.yaml", "gone_recovered/metadata.yaml")
    source = tmp_path / bag.removesuffix("/metadata.yaml")
    for number in (1, 10, 2):
        made(recovered_path(source, number), "metadata.yaml")
    copies = ["run_recovered", "run_recovered_2", "run_recovered_10"]
    assert below(tmp_path) == {"gone_recovered": [], "other": [], source.name: copies}
    made(tmp_path, "run_recovered_recovered/metadata.yaml")  # a copy that was damaged itself
    assert below(tmp_path)[source.name] == [copies[0], "run_recovered_recovered", *copies[1:]]
    assert len(below(tmp_path)) == 3


def test_nothing_is_no_folder_of_bags(tmp_path: Path):
    with pytest.raises(InputError, match="holds no bag"):
        bags_below(tmp_path)
    with pytest.raises(InputError, match="does not exist"):
        bags_below(tmp_path / "none")
