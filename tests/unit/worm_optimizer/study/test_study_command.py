# SPDX-License-Identifier: Apache-2.0
import dataclasses
import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pyarrow.parquet as parquet
import pytest
from recorded_run import simulated_run, write_bag
from study_cases import SMALL

from worm_model.parameters import KEYS as KEYS_OF_ROBOT
from worm_optimizer.commands import study as command
from worm_optimizer.robustness.sobol import METHODS
from worm_optimizer.study import fleet
from worm_optimizer.study.plan import COMPUTABLE, QUANTITIES
from worm_optimizer.study.study_file import StudyFile

_NAMES = {row.name for row in dataclasses.fields(StudyFile)}
ROOT = Path(__file__).resolve().parents[4]
COMMAND = "import sys; from worm_optimizer.commands.study import main; sys.exit(main())"
pytestmark = pytest.mark.timeout(300)


def run(monkeypatch, capsys, *arguments: str) -> tuple[int, str, str]:
    """Return exit status, standard output and error of `study`."""
    monkeypatch.setattr(sys, "argv", ["study", *arguments])
    status = command.main()
    captured = capsys.readouterr()
    return status, captured.out, captured.err


def test_a_killed_study_continues_with_the_same_bytes(tmp_path, monkeypatch, capsys, cluster):
    file, output, whole = tmp_path / "s.yaml", tmp_path / "s.nc", tmp_path / "whole.nc"
    file.write_text(SMALL)
    workers = ("--scheduler", cluster.scheduler_address)
    assert run(monkeypatch, capsys, str(file), "--output", str(whole), *workers)[0] == 0
    arguments = (str(file), "--output", str(output), *workers, "--json")
    killed = subprocess.Popen(
        [sys.executable, "-c", COMMAND, *arguments], stderr=subprocess.DEVNULL
    )
    deadline = time.monotonic() + 120.0
    while not list(tmp_path.glob("s.nc.blocks/*.npz")) and killed.poll() is None:
        assert time.monotonic() < deadline
        time.sleep(0.01)
    os.kill(killed.pid, signal.SIGKILL)
    killed.wait()
    status, out, _ = run(monkeypatch, capsys, *arguments)
    assert status == 0
    assert json.loads(out) == {"points": 6, "done": 6, "failed": 3, "output": str(output)}
    assert output.read_bytes() == whole.read_bytes()


def test_a_study_on_this_machine_its_page_and_its_table(tmp_path, monkeypatch, capsys):
    file, output, page = tmp_path / "s.yaml", tmp_path / "s.nc", tmp_path / "s.html"
    file.write_text(SMALL)
    arguments = (str(file), "--output", str(output), "--workers", "1", "--json")
    status, out, err = run(monkeypatch, capsys, *arguments)
    assert status == 0
    assert json.loads(out) == {"points": 6, "done": 6, "failed": 3, "output": str(output)}
    assert "100%" in err
    further = (*arguments, "--page", str(page), "--table", str(tmp_path / "s.csv"))
    assert run(monkeypatch, capsys, *further)[0] == 0  # nothing is left to compute
    assert len((tmp_path / "s.csv").read_text().splitlines()) == 7
    text = page.read_text()
    assert "the highest speed at 2.6 W" in text
    assert "less than half the pitch" in text
    assert "Less slack needs" in text
    assert text.count("data:image/png;base64,") == 1  # one quantity varies among the others
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
        (("s.yaml", "--bags", "."), "give one of STUDY.yaml"),
        (("absent.yaml",), "absent.yaml: cannot be read"),
        (("s.yaml",), "--output is missing"),
        (("s.yaml", "--output", "no/s.nc"), "no does not exist"),
        (("s.yaml", "--output", "s.nc", "--table", "no/s.csv"), "no does not exist"),
        (("s.yaml", "--output", "s.nc", "--workers", "0"), "give at least 1"),
        (("--bags", "."), "name the fleet's table"),
        (("--bags", ".", "--output", "f.parquet"), "holds no bag"),
        (("--bags", ".", "--output", "f.parquet", "--page", "f.html"), "for studies"),
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


def test_a_fleet_is_a_table_with_a_row_for_the_broken_bag(tmp_path, monkeypatch, capsys, here):
    folder, output = tmp_path / "bags", tmp_path / "f.parquet"
    write_bag(folder / "good", simulated_run(5, 1))
    (folder / "broken").mkdir()
    (folder / "broken" / "x.mcap").write_bytes(b"junk")
    arguments = ("--bags", str(folder), "--output", str(output), "--json")
    status, out, err = run(monkeypatch, capsys, *arguments)
    assert status == 1
    assert "1 of 2 failed" in err
    assert json.loads(out) == {"points": 2, "done": 2, "failed": 1, "output": str(output)}
    rows = {row["bag"]: row for row in parquet.read_table(output).to_pylist()}
    assert rows["broken/x.mcap"]["state"] == "failed"
    assert "is not an MCAP file" in rows["broken/x.mcap"]["reason"]
    assert rows["good"]["speed_m_s"] == pytest.approx(rows["good"]["expected_speed_m_s"], rel=0.1)
    assert run(monkeypatch, capsys, *arguments, "--accept-failures")[0] == 0
    assert here.pieces == 2  # nothing was left to read
    with monkeypatch.context() as other:
        other.setattr(fleet, "identity_of_all", lambda: "another version")
        assert run(monkeypatch, capsys, *arguments)[0] == 2
    write_bag(folder / "new", simulated_run(5, 2))
    status, _, err = run(monkeypatch, capsys, *arguments)
    assert status == 2
    assert "nothing is overwritten" in err
    output.unlink()
    assert run(monkeypatch, capsys, *arguments)[0] == 1
    assert here.pieces == 3  # only the new bag
    assert parquet.read_table(output, columns=["bag"]).num_rows == 3


def test_a_study_that_fails_everywhere_has_status_1(tmp_path, monkeypatch, capsys, here):
    file = tmp_path / "s.yaml"
    file.write_text(SMALL.replace("[0.008, 0.0175]", "[0.008]"))
    arguments = (str(file), "--output", str(tmp_path / "s.nc"), "--json")
    status, out, err = run(monkeypatch, capsys, *arguments)
    assert status == 1
    assert json.loads(out)["failed"] == 3
    assert "3 of 3 failed" in err
    assert run(monkeypatch, capsys, *arguments, "--accept-failures")[0] == 0


def test_a_saltelli_study_has_sobol_indices(tmp_path, monkeypatch, capsys, here):
    file, page = tmp_path / "s.yaml", tmp_path / "s.html"
    file.write_text(
        "vary: {idle_power: {range: [0.5, 1.5]}, rear_mass: {range: [0.4, 0.5]}}\n"
        "sample: {method: saltelli, points: 4}\n"
        "fixed: {margin_m: 0.002}\ncompute: [gaits]\n"
        "resolution: {strokes: 9, frequencies: 5}\n"
    )
    arguments = (str(file), "--output", str(tmp_path / "s.nc"))
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
