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

import pytest
import xarray
from study_cases import SMALL

from worm_model.parameters import KEYS as KEYS_OF_ROBOT
from worm_optimizer.commands import study as command
from worm_optimizer.robustness.sobol import METHODS
from worm_optimizer.study.plan import COMPUTABLE, QUANTITIES
from worm_optimizer.study.study_file import StudyFile

_NAMES = {row.name for row in dataclasses.fields(StudyFile)}
ROOT = Path(__file__).resolve().parents[4]
COMMAND = "import sys; from worm_optimizer.commands.study import main; sys.exit(main())"
pytestmark = pytest.mark.timeout(300)


def test_a_killed_study_continues_with_the_same_values(tmp_path, run, cluster):
    file, output, whole = tmp_path / "s.yaml", tmp_path / "s.nc", tmp_path / "whole.nc"
    file.write_text(SMALL)
    workers = ("--scheduler", cluster.scheduler_address)
    assert run(command, str(file), "--output", str(whole), *workers)[0] == 0
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
    status, out, _ = run(command, *arguments)
    assert status == 0
    assert json.loads(out) == {"points": 6, "done": 6, "failed": 3, "output": str(output)}
    # A worker that has just compiled the kernel rounds differently from one that loads it.
    xarray.testing.assert_allclose(xarray.load_dataset(output), xarray.load_dataset(whole), 1e-12)


def test_a_study_on_this_machine_its_page_and_its_table(tmp_path, run):
    file, output, page = tmp_path / "s.yaml", tmp_path / "s.nc", tmp_path / "s.html"
    file.write_text(SMALL)
    arguments = (str(file), "--output", str(output), "--workers", "1", "--json")
    status, out, err = run(command, *arguments)
    assert status == 0
    assert json.loads(out) == {"points": 6, "done": 6, "failed": 3, "output": str(output)}
    assert "100%" in err
    further = (*arguments, "--page", str(page), "--table", str(tmp_path / "s.csv"))
    assert run(command, *further)[0] == 0  # nothing is left to compute
    assert len((tmp_path / "s.csv").read_text().splitlines()) == 7
    text = page.read_text()
    assert "the highest speed at 2.6 W" in text
    assert "less than half the pitch" in text
    assert "Less slack needs" in text
    assert text.count("data:image/png;base64,") == 1  # one quantity varies among the others
    status, _, err = run(command, *arguments, "--page", str(page))
    assert status == 2
    assert "exists already" in err


def test_a_saltelli_study_has_sobol_indices(tmp_path, run, here):
    file, page = tmp_path / "s.yaml", tmp_path / "s.html"
    file.write_text(
        "vary: {idle_power: {range: [0.5, 1.5]}, rear_mass: {range: [0.4, 0.5]}}\n"
        "sample: {method: saltelli, points: 4}\n"
        "fixed: {margin_m: 0.002}\ncompute: [gaits]\n"
        "resolution: {strokes: 9, frequencies: 5}\n"
    )
    arguments = (str(file), "--output", str(tmp_path / "s.nc"))
    status, out, _ = run(command, *arguments, "--json", "--page", str(page))
    assert status == 0
    cost = json.loads(out)["indices"]["cost of transport"]
    assert set(cost) == {"idle_power", "rear_mass"}
    assert cost["idle_power"]["total"] > cost["rear_mass"]["total"]
    assert "Sobol indices" in page.read_text()
    assert "idle_power" in run(command, *arguments)[1]


def test_the_examples_are_studies(run):
    files = sorted((ROOT / "examples").glob("*.yaml"))
    assert files
    for file in files:
        status, out, _ = run(command, str(file), "--dry-run", "--json")
        assert status == 0
        assert json.loads(out)["points"] >= 2


def test_the_page_of_studies_names_every_key():
    page = (ROOT / "docs/studies.md").read_text()
    named = set(re.findall(r"`(\w+)`", page))
    assert {*set(QUANTITIES) - set(KEYS_OF_ROBOT), *COMPUTABLE, *METHODS, *_NAMES} <= named
