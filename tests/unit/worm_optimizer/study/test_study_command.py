# SPDX-License-Identifier: Apache-2.0
import dataclasses
import json
import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest
import xarray
from study_cases import SMALL
from waiting import wait_for

from worm_model.parameters import KEYS as KEYS_OF_ROBOT
from worm_optimizer.commands import study as command
from worm_optimizer.study.study_file import COMPUTABLE, QUANTITIES, StudyFile, load_study

_NAMES = {row.name for row in dataclasses.fields(StudyFile)}
ROOT = Path(__file__).resolve().parents[4]
COMMAND = "import sys; from worm_optimizer.commands.study import main; sys.exit(main())"
pytestmark = pytest.mark.timeout(300)


def test_a_killed_study_continues_with_the_same_values(tmp_path, run, cluster):
    file, output, whole = tmp_path / "s.yaml", tmp_path / "s.nc", tmp_path / "whole.nc"
    file.write_text(SMALL)
    status, out, err = run(command, file, "--output", whole, "--workers", "1", "--json")
    assert status == 0
    assert json.loads(out) == {"points": 6, "done": 6, "failed": 3, "output": str(whole)}
    assert "100%" in err
    workers = ("--scheduler", cluster.scheduler_address)
    arguments = (str(file), "--output", str(output), *workers, "--json")
    killed = subprocess.Popen(
        [sys.executable, "-c", COMMAND, *arguments], stderr=subprocess.DEVNULL
    )
    wait_for(lambda: [*tmp_path.glob("s.nc.blocks/*.block")] or killed.poll() is not None)
    os.kill(killed.pid, signal.SIGKILL)
    killed.wait()
    status, out, _ = run(command, *arguments)
    assert status == 0
    assert json.loads(out) == {"points": 6, "done": 6, "failed": 3, "output": str(output)}
    # A worker that has just compiled the kernel rounds differently from one that loads it.
    xarray.testing.assert_allclose(xarray.load_dataset(output), xarray.load_dataset(whole), 1e-12)


def test_the_examples_are_studies():
    files = sorted((ROOT / "examples").glob("*.yaml"))
    assert files
    assert all(load_study(file).file.size >= 2 for file in files)


def test_the_page_of_studies_names_every_key():
    page = (ROOT / "docs/studies.md").read_text()
    named = set(re.findall(r"`(\w+)`", page))
    assert {*set(QUANTITIES) - set(KEYS_OF_ROBOT), *COMPUTABLE, *_NAMES} <= named
