# SPDX-License-Identifier: Apache-2.0
"""Metadata of a bag about its run."""

import hashlib
from pathlib import Path

import pytest
from recorded_run import simulated_run

from worm_model.bags.formats.bag_writer import new_bag
from worm_model.bags.formats.stored_file import AttachedFile
from worm_model.bags.opening import open_bag
from worm_model.bags.recording.run_manifest import (
    PARAMETER_ATTACHMENT,
    ManifestError,
    recorded_conditions,
    recorded_parameters,
    recorded_robot,
    run_manifest,
)
from worm_model.bags.run_writer import write_run
from worm_model.loads import under
from worm_model.parameters import PAPER, ParameterFile
from worm_msgs.conditions import LEVEL, Conditions

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


STEEP = Conditions(slope_deg=20.0, tether_n=2.0, tether_n_per_m=0.5, distance_m=3.0)


def _bag_under(path: Path, *conditions: Conditions, file: Path | None = None) -> Path:
    """Write a bag with the manifest of a recording under each of the conditions."""
    with new_bag(path) as writer:
        for each in conditions:
            manifest = run_manifest(file, None, [], ["record"], NOW, each)
            for name, values in manifest.metadata.items():
                writer.add_metadata(name, values)
            for attached in manifest.attachments:
                writer.add_attachment(attached)
        write_run(writer, simulated_run(1))
    return path


@pytest.mark.parametrize("conditions", [LEVEL, STEEP, Conditions(slope_deg=-1 / 3)])
def test_the_conditions_of_a_recording_are_those_it_was_made_under(tmp_path: Path, conditions):
    with open_bag(_bag_under(tmp_path / "bag", conditions)) as bag:
        assert recorded_conditions(bag) == conditions
        assert recorded_robot(bag).parameters == under(conditions, PAPER)


def test_a_recorded_robot_has_the_loads_with_its_own_and_with_any_other_parameter_file(
    tmp_path: Path,
):
    own, other = tmp_path / "own.yaml", tmp_path / "other.yaml"
    own.write_text("gain: 0.9\nrear_load: 1.0\n")
    other.write_text("gain: 0.8\n")
    with open_bag(_bag_under(tmp_path / "bag", STEEP, file=own)) as bag:
        loaded = under(STEEP, PAPER.replace(gain=0.9, rear_load=1.0))
        assert recorded_robot(bag).parameters == loaded
        assert recorded_robot(bag, str(other)).parameters == under(STEEP, PAPER.replace(gain=0.8))
        assert recorded_parameters(bag) == ParameterFile(PAPER.replace(gain=0.9, rear_load=1.0))


def test_runs_of_different_conditions_are_not_judged_by_one_of_them(tmp_path: Path):
    both = _bag_under(tmp_path / "both", LEVEL, STEEP)
    with open_bag(both) as bag, pytest.raises(ManifestError, match="conditions"):
        recorded_robot(bag)


def test_stored_conditions_that_cannot_be_used_are_reported(tmp_path: Path):
    with new_bag(tmp_path / "bag") as writer:
        writer.add_metadata("worm_run", {"slope_deg": "steep"})
        write_run(writer, simulated_run(1))
    with open_bag(tmp_path / "bag") as bag, pytest.raises(ManifestError, match="steep"):
        recorded_robot(bag)


def test_an_argument_that_is_not_text_is_kept_with_escapes():
    manifest = run_manifest(None, None, [], ["record", "\udcff"], NOW)
    assert manifest.metadata["worm_run"]["command"] == "record \\udcff"
