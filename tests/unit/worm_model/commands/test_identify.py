# SPDX-License-Identifier: Apache-2.0
"""The command identify: a lab's folder and bags, its outputs, and the inputs that it rejects."""

import contextlib
import io
import json
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
from recorded_run import Instruments, exact_run, write_bag

from worm_model.commands import identify
from worm_model.errors import IdentificationError
from worm_model.gait import Gait
from worm_model.identification.inputs import read_inputs, read_recordings
from worm_model.identification.reference_values import reference_by_folder
from worm_model.parameters import KEYS, PAPER, load_parameter_file

ROOT = Path(__file__).resolve().parents[4]
RUNS = ("run_05", "run_06", "run_07", "run_08")
GAIT = Gait(0.08, 0.25)


@pytest.fixture(scope="module")
def outcome(shared, tmp_path_factory):
    """Return status, output and folder of one call with all inputs, on a part of the campaign."""
    folder = tmp_path_factory.mktemp("identify")
    campaign = folder / "campaign"
    campaign.mkdir()
    for name in ("README.md", "runs.json", "bellows.csv", "fin.csv"):
        shutil.copy(shared / "campaign" / name, campaign)
    for name in RUNS:
        shutil.copytree(shared / "campaign" / name, campaign / name)
    outputs = ["--output", f"{folder}/parameters.yaml", "--report", f"{folder}/report"]
    printed = io.StringIO()
    with pytest.MonkeyPatch.context() as monkeypatch, contextlib.redirect_stdout(printed):
        monkeypatch.setattr(sys, "argv", ["identify", str(campaign), "--json", *outputs])
        status = identify.main()
    return status, printed.getvalue(), folder


@pytest.mark.night
def test_the_campaign_gives_every_key_of_the_contract_and_is_predicted_to_the_cameras_noise(
    outcome,
):
    status, printed, _ = outcome
    assert status == 0
    found = json.loads(printed)
    assert set(found["parameters"]) == set(KEYS)
    for key, entry in found["parameters"].items():
        assert entry["low"] <= entry["value"] <= entry["high"], key
        assert entry["identifiable"], key
    assert set(found["runs"]) == set(RUNS)
    for run, errors in found["runs"].items():
        assert set(errors) == {"x1_rmse", "length_rmse", "power_rmse", "energy_error"}
        assert errors["x1_rmse"] < 5e-4
        assert errors["length_rmse"] < min(5e-4, 0.5 * found["paper"][run]["length_rmse"])
        assert abs(errors["energy_error"]) < 0.03


@pytest.mark.night
def test_the_parameter_file_and_the_report_contain_everything(outcome, run):
    found, folder = json.loads(outcome[1])["parameters"], outcome[2]
    file = load_parameter_file(folder / "parameters.yaml")
    values = {key: found[key]["value"] for key in KEYS}
    assert file.parameters.as_dict() == pytest.approx({**values, "one_sided_cable": False})
    assert set(file.intervals) == set(KEYS)
    assert file.parameters.rear_mass == 0.433  # from the README
    assert set(file.correlations) > {("slack", "gain"), ("bellows_damping", "power_factor")}
    low, high = file.intervals["initial_length"]  # of the mean, so narrower than a run's
    assert 0.5 * (high - low) < 3.2 * file.run_to_run["initial_length"] < 2.0 * (high - low)
    assert set(file.provenance["runs"]) == set(RUNS)
    assert len(file.provenance["runs"]["run_05"]["camera.csv"]) == 64
    assert file.provenance["code"].startswith("worm_model")
    text = (folder / "report" / "report.md").read_text(encoding="utf-8")
    pictures = sorted(path.name for path in (folder / "report" / "figures").glob("*.png"))
    assert len(pictures) == 2 + 3 * 4
    assert all(f"figures/{name}" in text for name in pictures)
    assert all(symbol in text for symbol in ("p_sw", "α_P", "Recommended measurement", "D1", "D2"))
    for option, path in (("--output", "parameters.yaml"), ("--report", "report")):
        status, _, error = run(identify, folder / "campaign", option, folder / path)
        assert status == 2
        assert "exists already" in error


def test_nothing_is_written_before_all_is_known(shared, tmp_path, monkeypatch, run):
    def fail(_):
        raise IdentificationError("no advice")

    monkeypatch.setattr("worm_model.identification.stages.identify", lambda *_: None)
    monkeypatch.setattr("worm_model.identification.report.advice.advise", fail)
    output = tmp_path / "robot.yaml"
    status, _, error = run(identify, shared / "campaign" / "run_07", "--output", output)
    assert status == 2
    assert "no advice" in error
    assert not output.exists()


def test_a_bench_test_that_cannot_be_read_and_two_runs_of_one_name_are_rejected(tmp_path):
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        write_bag(tmp_path / folder / "run", exact_run(GAIT, PAPER, Instruments(), 0, 7.0))
    with pytest.raises(IdentificationError, match="two runs are called run"):
        read_inputs([tmp_path / "a" / "run", tmp_path / "b" / "run"])
    (tmp_path / "bellows.csv").write_text("compression,force\n0,1\n", encoding="utf-8")
    with pytest.raises(IdentificationError, match="has no column compression_m"):
        read_inputs([tmp_path / "a" / "run"], tmp_path / "bellows.csv")


def test_runs_of_one_lab_use_the_files_next_to_them(shared):
    campaign = shared / "campaign"
    paths = [campaign / "run_07", campaign / "run_08"]
    inputs = read_inputs(paths)
    assert [recording.name for recording in inputs.recordings] == ["run_07", "run_08"]
    assert inputs.folder == campaign.resolve()
    assert None not in (inputs.bellows, inputs.fin)
    assert [remark.split(",")[0] for remark in inputs.remarks] == [
        "all runs: gait from 2.00 s on",
        "all runs: spool radius 12.00 mm",
    ]
    assert read_inputs(paths[:1]).folder == campaign.resolve()
    names = [recording.name for recording in read_recordings([campaign])]
    assert names == [f"run_{k:02d}" for k in range(1, 9)]


def test_runs_of_several_labs_report_that_no_files_next_to_them_are_used(shared, tmp_path):
    for name in ("runs.json", "fin.csv"):
        shutil.copy(shared / "campaign" / name, tmp_path)
    shutil.copytree(shared / "campaign" / "run_07", tmp_path / "run_07")
    inputs = read_inputs([tmp_path / "run_07", shared / "campaign" / "run_08"])
    assert inputs.folder is None
    assert inputs.fin is None
    assert "--parameters, --bellows" in inputs.remarks[0]


def test_a_readme_may_give_bounds_and_leave_keys_out(tmp_path):
    text = "M1 = 0.433 ± 0.002 kg, M2 = 424 g +/- 3 g; d = 17.5 ± 0.02 mm. B = d = 4."
    (tmp_path / "README.md").write_text(text, encoding="utf-8")
    reference = reference_by_folder(tmp_path)
    rear, front, pitch = (reference.estimate(k) for k in ("rear_mass", "front_mass", "pitch"))
    assert (rear.low, rear.high) == pytest.approx((0.431, 0.435))
    assert (front.low, front.high) == pytest.approx((0.421, 0.427))
    assert (pitch.low, pitch.high) == pytest.approx((0.01748, 0.01752))
    assert "README.md" in rear.note
    assert reference.estimate("unstressed_length").note == "as given by the paper"
    assert reference.estimate("slack").note == "as given by the paper"


@pytest.mark.parametrize(("name", "direction"), [("forward", 1), ("reverse", -1)])
def test_bags_of_the_driver_are_read_from_rest_to_the_end_of_the_gait(name, direction):
    path = ROOT / "bags" / name
    recording = read_recordings([path])[0]
    assert recording.date.startswith("20")
    assert any(len(checksum) == 64 for checksum in recording.sources.values())
    assert recording.gait.direction == direction
    assert recording.at_rest.sum() >= 10
    for time in (recording.camera_time, recording.power_time, recording.command_time):
        assert -1.02 <= time[0] <= 0.0  # the driver was idle before
        cycles = time[-1] * recording.gait.frequency
        assert cycles == pytest.approx(round(cycles), abs=0.02)
    assert np.nanmax(direction * recording.x1) > 0.03
