# SPDX-License-Identifier: Apache-2.0
"""Files of blocks, and real workers in processes of their own, killed as by the kernel."""

import contextlib
import json
import os
import random
import shutil
import subprocess
import sys
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import dask
import numpy as np
import pytest
from distributed import Client, LocalCluster
from waiting import wait_for
from worker_jobs import double, murder, suicide

from worm_model.errors import InputError
from worm_optimizer.study.blocks import LostError, Workers, complete

ROOT = Path(__file__).resolve().parents[4]
pytestmark = pytest.mark.timeout(300)
NONE = Workers("tcp://127.0.0.1:1")  # no workers: nothing may be left to compute


def found(
    folder: Path,
    workers: Workers = NONE,
    function=double,
    count: int = 3,
    identity: str = "1",
    say=print,
    progress=lambda done: None,
) -> list[list[float]]:
    """Compute the double of two numbers in each of some blocks."""
    pieces = list(np.arange(2.0 * count).reshape(count, 2))
    blocks = complete(function, pieces, identity, folder / "blocks", workers, say, progress)
    return [block["double"].tolist() for block in blocks]


def doubled(count: int = 3) -> list[list[float]]:
    return [[4.0 * k, 4.0 * k + 2.0] for k in range(count)]


def files_of(folder: Path) -> list[Path]:
    return sorted((folder / "blocks").glob("*.block"))


@pytest.mark.parametrize("seed", range(6))
def test_a_deleted_a_cut_and_a_changed_block_are_computed_again(tmp_path, here, seed):
    said: list[str] = []
    found(tmp_path)
    deleted, cut, changed = files_of(tmp_path)
    draw = random.Random(seed)
    deleted.unlink()
    data = bytearray(changed.read_bytes())
    cut.write_bytes(cut.read_bytes()[: draw.randrange(len(data))])
    data[draw.randrange(len(data))] ^= 1 << draw.randrange(8)
    changed.write_bytes(data)
    assert found(tmp_path, say=said.append) == doubled()
    assert here.pieces == 6
    assert sum("is damaged" in line for line in said) == 2


def test_blocks_of_another_version_are_not_used(tmp_path, here):
    said: list[str] = []
    found(tmp_path, identity="1")
    found(tmp_path, identity="2", say=said.append)
    assert here.pieces == 6
    assert any("another computation or version: 3" in line for line in said)


def test_what_a_killed_worker_had_is_done_by_another(cluster, tmp_path):
    work = partial(suicide, str(tmp_path / "killed"))
    assert found(tmp_path, Workers(cluster.scheduler_address), work) == doubled()
    assert (tmp_path / "killed").exists()


@contextlib.contextmanager
def process(name: str, *arguments: str, cwd: Path, path: str) -> Iterator[subprocess.Popen]:
    """Start a scheduler or a worker, and kill it at the end."""
    with subprocess.Popen(
        [sys.executable, "-m", f"distributed.cli.{name}", *arguments, "--no-dashboard"],
        cwd=cwd,  # one of our folders would precede the path
        env={**os.environ, "PYTHONPATH": path},
        stderr=subprocess.DEVNULL,
    ) as started:
        try:
            yield started
        finally:
            started.kill()


@pytest.mark.night
def test_a_killed_scheduler_is_reported_and_its_blocks_remain(tmp_path, cluster):
    file = tmp_path / "s.json"
    path = os.pathsep.join([os.environ["PYTHONPATH"], str(ROOT / "tests/helpers")])
    with process(
        "dask_scheduler", "--port", "0", "--scheduler-file", str(file), cwd=tmp_path, path=path
    ) as scheduler:
        wait_for(lambda: file.exists() and file.read_text().endswith("}"))
        address = json.loads(file.read_text())["address"]

        def kill_after_the_first(done: float) -> None:
            if done > 0.0:
                scheduler.kill()

        with (
            process(
                *("dask_worker", address, "--no-nanny", "--nthreads", "1"), cwd=tmp_path, path=path
            ),
            pytest.raises(LostError, match=r"of 20 blocks are finished, in .*repeat the command"),
        ):
            found(tmp_path, Workers(address), count=20, progress=kill_after_the_first)
    assert 1 <= len(files_of(tmp_path)) < 20
    assert found(tmp_path, Workers(cluster.scheduler_address), count=20) == doubled(20)


@pytest.mark.night
def test_a_block_that_kills_each_worker_is_one_line(tmp_path):
    with pytest.raises(LostError, match=r"are lost.*0 of 3 blocks are finished"):
        found(tmp_path, Workers(number=1), murder)


def test_no_scheduler_and_no_workers_are_one_line(tmp_path, monkeypatch):
    with pytest.raises(InputError, match="no Dask scheduler"):
        found(tmp_path)
    (tmp_path / "broken.py").write_text("raise RuntimeError('broken on purpose')\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    with (
        dask.config.set({"distributed.worker.preload": ["broken"]}),
        pytest.raises(InputError, match="--workers") as raised,
    ):
        found(tmp_path, Workers(number=1))
    assert "\n" not in str(raised.value)


def test_a_worker_without_the_package_is_rejected_by_name_at_once(tmp_path):
    """Dask never reports a block that such a worker cannot load."""
    shutil.copy(ROOT / "tests/helpers/worker_jobs.py", tmp_path)
    folders = tmp_path, ROOT / "src" / "worm_model", ROOT / "src" / "worm_msgs"
    path = os.pathsep.join(map(str, folders))
    with (
        LocalCluster(n_workers=0, dashboard_address="127.0.0.1:0") as empty,
        Client(empty) as client,
    ):
        worker = "dask_worker", empty.scheduler_address, "--no-nanny", "--nthreads", "1"
        with process(*worker, cwd=tmp_path, path=path):
            client.wait_for_workers(1, timeout=120)
            with pytest.raises(InputError, match=r"worker tcp.*No module named"):
                found(tmp_path, Workers(empty.scheduler_address))
