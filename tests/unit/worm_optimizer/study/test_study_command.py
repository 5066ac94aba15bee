# SPDX-License-Identifier: Apache-2.0
import dataclasses
import json
import re
import sys
from pathlib import Path

import pyarrow.parquet as parquet
import pytest
from recorded_run import simulated_run, write_bag
from study_cases import SMALL, contents

from worm_model.parameters import KEYS as KEYS_OF_ROBOT
from worm_optimizer.commands import study as command
from worm_optimizer.study import fleet
from worm_optimizer.study.plan import COMPUTABLE, METHODS
from worm_optimizer.study.quantities import QUANTITIES
from worm_optimizer.study.study_file import StudyFile

_NAMES = {row.name for row in dataclasses.fields(StudyFile)}
ROOT = Path(__file__).resolve().parents[4]
pytestmark = pytest.mark.timeout(300)


def run(monkeypatch, capsys, *arguments: str) -> tuple[int, str, str]:
    """Return exit status, standard output and error of `study`."""
    monkeypatch.setattr(sys, "argv", ["study", *arguments])
    status = command.main()
    captured = capsys.readouterr()
    return status, captured.out, captured.err


def test_a_study_on_this_machine_and_its_page(tmp_path, monkeypatch, capsys):
    file, output, page = tmp_path / "s.yaml", tmp_path / "s.zarr", tmp_path / "s.html"
    file.write_text(SMALL)
    arguments = (str(file), "--output", str(output), "--workers", "1", "--json")
    status, out, err = run(monkeypatch, capsys, *arguments)
    assert status == 0
    assert json.loads(out) == {"points": 6, "done": 6, "failed": 3, "output": str(output)}
    assert "100%" in err
    assert "http://127.0.0.1:" in err
    before = contents(output)
    status, out, _ = run(
        monkeypatch, capsys, *arguments, "--page", str(page)
    )  # nothing is left to compute
    assert status == 0
    assert contents(output) == before
    text = page.read_text()
    assert "the highest speed at 2.6 W" in text
    assert "less than half the pitch" in text
    assert "Less slack needs" in text
    assert (
        text.count("data:image/png;base64,") == 1
    )  # one quantity varies among the computed points
    status, _, err = run(monkeypatch, capsys, *arguments, "--page", str(page))
    assert status == 2
    assert "exists already" in err


def test_a_dry_run_prints_points_blocks_and_time_and_leaves_nothing(tmp_path, monkeypatch, capsys):
    file = tmp_path / "s.yaml"
    file.write_text(SMALL)
    status, out, _ = run(monkeypatch, capsys, str(file), "--dry-run", "--json")
    reported = json.loads(out)
    assert status == 0
    assert (reported["points"], reported["blocks"]) == (6, 6)
    assert reported["seconds"] > 0.0
    assert list(tmp_path.iterdir()) == [file]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((), "give one of STUDY.yaml"),
        (("s.yaml", "--verify", "s.zarr"), "give one of STUDY.yaml"),
        (("--verify", "absent.zarr"), "absent.zarr: does not exist"),
        (("--from", "."), "not a study"),
        (("--from", ".", "--parameters", "p.yaml"), "remove the option"),
        (("s.yaml", "--output", "s.zarr", "--export", "s.xlsx"), "none of .nc, .csv"),
        (("absent.yaml",), "absent.yaml: cannot be read"),
        (("s.yaml",), "--output is missing"),
        (("s.yaml", "--output", "no/s.zarr"), "no does not exist"),
        (("s.yaml", "--output", "s.zarr", "--workers", "0"), "give at least 1"),
        (("--bags", "."), "name the fleet's table"),
        (("--bags", ".", "--output", "f.parquet"), "holds no bag"),
        (("--bags", "absent", "--output", "f.parquet"), "does not exist"),
        (("s.yaml", "--parameters", "absent.yaml", "--dry-run"), "cannot be read"),
    ],
)
def test_bad_input_is_one_line_and_status_2(arguments, message, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("s.yaml").write_text(SMALL)
    status, out, err = run(monkeypatch, capsys, *arguments)
    assert status == 2
    assert message in err
    assert err.count("\n") == 1
    assert not out


def test_a_fleet_is_a_table_with_a_row_for_the_broken_bag(tmp_path, monkeypatch, capsys):
    folder, output, page = tmp_path / "bags", tmp_path / "f.parquet", tmp_path / "f.html"
    write_bag(folder / "good", simulated_run(5, 1))
    (folder / "broken").mkdir()
    (folder / "broken" / "x.mcap").write_bytes(b"junk")
    arguments = ("--bags", str(folder), "--output", str(output), "--workers", "1", "--json")
    status, out, err = run(monkeypatch, capsys, *arguments, "--page", str(page))
    assert status == 1
    assert "1 of 2 failed" in err
    assert json.loads(out) == {"points": 2, "done": 2, "failed": 1, "output": str(output)}
    rows = {row["bag"]: row for row in parquet.read_table(output).to_pylist()}
    assert rows["broken/x.mcap"]["state"] == "failed"
    assert "is not an MCAP file" in rows["broken/x.mcap"]["reason"]
    assert rows["good"]["speed_m_s"] == pytest.approx(rows["good"]["expected_speed_m_s"], rel=0.1)
    assert "is not an MCAP file" in page.read_text()
    assert not list(tmp_path.glob("*.part"))
    assert run(monkeypatch, capsys, *arguments)[0] == 1  # nothing is left to read
    assert run(monkeypatch, capsys, *arguments, "--accept-failures")[0] == 0
    before = output.read_bytes()
    assert run(monkeypatch, capsys, *arguments, "--retry-failed", "--accept-failures")[0] == 0
    assert output.read_bytes() == before
    with monkeypatch.context() as other:
        other.setattr(fleet, "identity_of_all", lambda: "another version")
        status, _, err = run(monkeypatch, capsys, *arguments)
    assert status == 2
    assert "nothing is overwritten" in err
    write_bag(folder / "new", simulated_run(5, 2))
    status, _, err = run(monkeypatch, capsys, *arguments)
    assert status == 2
    assert "nothing is overwritten" in err


def test_verify_retry_and_repeat(tmp_path, monkeypatch, capsys, cluster):
    workers = ("--scheduler", cluster.scheduler_address)
    file, output, copy = tmp_path / "s.yaml", tmp_path / "s.zarr", tmp_path / "copy.zarr"
    file.write_text(SMALL)
    command = (str(file), "--output", str(output), *workers, "--json")
    assert run(monkeypatch, capsys, *command)[0] == 0
    before = contents(output)
    status, out, _ = run(monkeypatch, capsys, "--verify", str(output), "--json")
    assert status == 0
    assert json.loads(out)["damaged"] == 0
    assert run(monkeypatch, capsys, *command, "--retry-failed")[0] == 0
    assert contents(output) == before

    speed = next(file for file in (output / "speed").iterdir() if file.name[0].isdigit())
    speed.unlink()
    status, out, err = run(monkeypatch, capsys, "--verify", str(output), "--json")
    assert status == 1
    assert json.loads(out)["damaged"] == 3  # the other three failed, and are NaN
    assert "values of 3 points are missing or damaged" in err
    damaged = contents(output)
    status, _, err = run(monkeypatch, capsys, "--from", str(output), *workers)
    assert status == 0
    assert "damaged" in err
    assert contents(output) == before != damaged

    speed.write_bytes(b"junk")
    status, _, err = run(monkeypatch, capsys, *command)
    assert status == 0
    assert str(speed) in err
    assert contents(output) == before

    repeat = ("--from", str(output), "--output", str(copy), *workers)
    assert run(monkeypatch, capsys, *repeat)[0] == 0
    assert contents(copy) == before


def test_a_study_that_fails_everywhere_has_status_1(tmp_path, monkeypatch, capsys, cluster):
    workers = ("--scheduler", cluster.scheduler_address)
    file = tmp_path / "s.yaml"
    file.write_text(SMALL.replace("[0.008, 0.0175]", "[0.008]"))
    arguments = (str(file), "--output", str(tmp_path / "s.zarr"), *workers, "--json")
    status, out, err = run(monkeypatch, capsys, *arguments)
    assert status == 1
    assert json.loads(out)["failed"] == 3
    assert "3 of 3 failed" in err
    assert run(monkeypatch, capsys, *arguments, "--accept-failures")[0] == 0


def test_a_saltelli_study_has_sobol_indices(tmp_path, monkeypatch, capsys, cluster):
    workers = ("--scheduler", cluster.scheduler_address)
    file, page = tmp_path / "s.yaml", tmp_path / "s.html"
    file.write_text(
        "vary: {idle_power: {range: [0.5, 1.5]}, rear_mass: {range: [0.4, 0.5]}}\n"
        "sample: {method: saltelli, points: 4}\n"
        "fixed: {margin_m: 0.002}\ncompute: [gaits]\n"
        "resolution: {strokes: 9, frequencies: 5}\n"
    )
    arguments = (str(file), "--output", str(tmp_path / "s.zarr"), *workers)
    status, out, _ = run(monkeypatch, capsys, *arguments, "--json", "--page", str(page))
    assert status == 0
    cost = json.loads(out)["indices"]["cost of transport"]
    assert set(cost) == {"idle_power", "rear_mass"}
    assert cost["idle_power"]["total"] > cost["rear_mass"]["total"]
    assert "Sobol indices" in page.read_text()
    assert "idle_power" in run(monkeypatch, capsys, *arguments)[1]


def test_the_examples_are_studies(monkeypatch, capsys):
    files = sorted((ROOT / "examples").glob("*.yaml"))
    assert files
    for file in files:
        status, out, _ = run(monkeypatch, capsys, str(file), "--dry-run", "--json")
        assert status == 0
        assert json.loads(out)["points"] >= 2


def test_the_page_of_studies_names_every_key():
    page = (ROOT / "docs/studies.md").read_text()
    named = set(re.findall(r"`(\w+)`", page))
    assert {*set(QUANTITIES) - set(KEYS_OF_ROBOT), *COMPUTABLE, *METHODS, *_NAMES} <= named
