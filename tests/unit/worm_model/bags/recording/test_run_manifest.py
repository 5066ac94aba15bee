# SPDX-License-Identifier: Apache-2.0
"""What a bag says of its run."""

import hashlib
from pathlib import Path

import pytest
from recorded_run import simulated_run

from worm_model.bags.bag import AttachedFile
from worm_model.bags.formats.bag_writer import new_bag
from worm_model.bags.opening import open_bag
from worm_model.bags.recording.run_manifest import (
    PARAMETER_ATTACHMENT,
    ManifestError,
    recorded_parameters,
    run_manifest,
)
from worm_model.bags.run_writer import write_run
from worm_model.parameters import PAPER, ParameterFile

NOW = 1_800_000_000_000_000_000


def test_the_parameter_file_is_kept_with_its_hash(tmp_path: Path):
    file = tmp_path / "robot.yaml"
    file.write_text("pitch: 0.0173\n")
    manifest = run_manifest(file, 7, ["pipe=B, dry"], ["/opt/bin/record", "--all"], NOW)
    record = manifest.metadata["worm_run"]
    assert record["parameter_sha256"] == hashlib.sha256(b"pitch: 0.0173\n").hexdigest()
    assert (record["seed"], record["note.pipe"]) == ("7", "B, dry")
    assert record["recorded_at"] == "2027-01-15T08:00:00+00:00"
    assert record["version.mcap"]
    assert record["command"] == "record --all"
    assert manifest.attachments[0].data == b"pitch: 0.0173\n"


def test_runs_of_different_parameter_files_are_not_judged_by_one_of_them(tmp_path: Path):
    texts = {"same": (b"gain: 0.9", b"gain: 0.9"), "other": (b"gain: 0.9", b"gain: 0.8")}
    for name, attached in texts.items():
        with new_bag(tmp_path / name) as writer:
            for text in attached:
                writer.add_attachment(AttachedFile(PARAMETER_ATTACHMENT, "application/yaml", text))
            write_run(writer, simulated_run(1))
    with open_bag(tmp_path / "same") as bag:
        assert recorded_parameters(bag) == ParameterFile(PAPER.replace(gain=0.9))
    with (
        open_bag(tmp_path / "other") as bag,
        pytest.raises(ManifestError, match="give --parameters FILE for all"),
    ):
        recorded_parameters(bag)


def test_without_a_parameter_file_none_is_claimed():
    manifest = run_manifest(None, None, [], ["record"], NOW)
    assert manifest.attachments == ()
    assert manifest.metadata["worm_run"]["parameter_sha256"] == ""


@pytest.mark.parametrize("note", ["pipe", "=B"])
def test_a_note_has_a_key_and_a_value(note: str):
    with pytest.raises(ManifestError, match="KEY=VALUE"):
        run_manifest(None, None, [note], ["record"], NOW)


def test_a_parameter_file_that_is_missing_is_named(tmp_path: Path):
    with pytest.raises(ManifestError, match=r"robot\.yaml"):
        run_manifest(tmp_path / "robot.yaml", None, [], ["record"], NOW)


def test_a_note_that_is_not_text_is_refused():
    with pytest.raises(ManifestError, match="UTF-8"):
        run_manifest(None, None, ["pipe=\udcff"], ["record"], NOW)


def test_an_argument_that_is_not_text_is_kept_with_escapes():
    manifest = run_manifest(None, None, [], ["record", "\udcff"], NOW)
    assert manifest.metadata["worm_run"]["command"] == "record \\udcff"
