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
from pathlib import Path

import dask
import numpy as np
import pytest
from distributed import Client, LocalCluster
from waiting import wait_for
from worker_jobs import double, murder, reject, suicide

from worm_model.errors import InputError
from worm_optimizer.study.blocks import ITEMS, LostError, Task, Workers, complete

ROOT = Path(__file__).resolve().parents[4]
pytestmark = pytest.mark.timeout(300)
NONE = Workers("tcp://127.0.0.1:1")  # no workers: nothing may be left to compute


def task(function=double, common: object = None, items: int = 6, identity: str = "1") -> Task:
    return Task(function, common, np.arange(float(items)).reshape(-1, 1), 2, identity)


def found(task: Task, output: Path, workers: Workers, say=print) -> dict[float, float]:
    """Return the results by item."""
    return {
        item: value
        for block in complete(task, output, workers, say, lambda done: None)
        for item, value in zip(block[ITEMS][:, 0].tolist(), block["double"].tolist(), strict=True)
    }


def doubled(items: int) -> dict[float, float]:
    return {float(k): 2.0 * k for k in range(items)}


def test_blocks_are_computed_once(tmp_path, here):
    output = tmp_path / "out.nc"
    assert found(task(), output, NONE) == doubled(6)
    assert here.pieces == 3
    assert found(task(), output, NONE) == doubled(6)
    assert here.pieces == 3
    assert found(task(items=9), output, NONE) == doubled(9)  # more items: only these
    assert here.pieces == 5


def files_of(output: Path) -> list[Path]:
    return sorted(output.with_name(f"{output.name}.blocks").glob("*.npz"))


@pytest.mark.parametrize("seed", range(6))
def test_a_deleted_a_cut_and_a_changed_block_are_computed_again(tmp_path, here, seed):
    output, said = tmp_path / "out.nc", []
    found(task(), output, NONE)
    deleted, cut, changed = files_of(output)
    draw = random.Random(seed)
    deleted.unlink()
    data = bytearray(changed.read_bytes())
    cut.write_bytes(cut.read_bytes()[: draw.randrange(len(data))])
    data[draw.randrange(len(data))] ^= 1 << draw.randrange(8)
    changed.write_bytes(data)
    assert found(task(), output, NONE, said.append) == doubled(6)
    assert here.pieces == 6
    assert any("damaged blocks: 2" in line for line in said)


def test_blocks_of_another_version_are_not_used(tmp_path, here):
    output, said = tmp_path / "out.nc", []
    found(task(identity="1"), output, NONE)
    found(task(identity="2"), output, NONE, said.append)
    assert here.pieces == 6
    assert any("another computation or version: 3" in line for line in said)


def test_what_a_killed_worker_had_is_done_by_another(cluster, tmp_path):
    work = task(suicide, str(tmp_path / "killed"))
    assert found(work, tmp_path / "out.nc", Workers(cluster.scheduler_address)) == doubled(6)
    assert (tmp_path / "killed").exists()


def test_an_error_of_the_work_is_passed_on(cluster, tmp_path):
    with pytest.raises(ValueError, match="piece"):
        found(task(reject), tmp_path / "out.nc", Workers(cluster.scheduler_address))


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
    output, file = tmp_path / "out.nc", tmp_path / "s.json"
    path = os.pathsep.join([os.environ["PYTHONPATH"], str(ROOT / "tests/helpers")])
    with process(
        "dask_scheduler", "--port", "0", "--scheduler-file", str(file), cwd=tmp_path, path=path
    ) as scheduler:
        wait_for(file.exists)
        address = json.loads(file.read_text())["address"]

        def kill_after_the_first(done: float) -> None:
            if done > 0.0:
                scheduler.kill()

        with (
            process(
                *("dask_worker", address, "--no-nanny", "--nthreads", "1"), cwd=tmp_path, path=path
            ),
            pytest.raises(LostError, match=r"of 40 are finished, in .*repeat the command"),
        ):
            complete(task(items=40), output, Workers(address), print, kill_after_the_first)
    assert 1 <= len(files_of(output)) < 20
    assert found(task(items=40), output, Workers(cluster.scheduler_address)) == doubled(40)


@contextlib.contextmanager
def foreign_worker(folder: Path, *packages: str) -> Iterator[str]:
    """Return the address of a scheduler whose only worker runs in ``folder`` with these packages."""
    path = os.pathsep.join([str(folder), *(str(ROOT / "src" / package) for package in packages)])
    with (
        LocalCluster(n_workers=0, dashboard_address="127.0.0.1:0") as empty,
        process(
            *("dask_worker", empty.scheduler_address, "--no-nanny", "--nthreads", "1"),
            cwd=folder,
            path=path,
        ),
        Client(empty) as client,
    ):
        client.wait_for_workers(1, timeout=120)
        yield empty.scheduler_address


@pytest.mark.night
def test_a_worker_of_another_version_is_rejected_by_name(tmp_path):
    package = tmp_path / "worm_optimizer"
    shutil.copytree(ROOT / "src/worm_optimizer/worm_optimizer", package)
    with (package / "study/point.py").open("a") as file:
        file.write("\n# another version\n")
    shutil.copy(ROOT / "tests/helpers/worker_jobs.py", tmp_path)
    with (
        foreign_worker(tmp_path, "worm_model", "worm_msgs") as address,
        pytest.raises(InputError, match=r"worker tcp.*another version"),
    ):
        found(task(), tmp_path / "out.nc", Workers(address))


@pytest.mark.night
def test_a_block_that_kills_each_worker_is_one_line(tmp_path):
    with pytest.raises(LostError, match=r"have died.*0 of 6 are finished"):
        found(task(murder), tmp_path / "out.nc", Workers(number=1))


def test_no_scheduler_and_no_workers_are_one_line(tmp_path, monkeypatch):
    with pytest.raises(InputError, match="no Dask scheduler"):
        found(task(), tmp_path / "out.nc", NONE)
    (tmp_path / "broken.py").write_text("raise RuntimeError('broken on purpose')\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    with (
        dask.config.set({"distributed.worker.preload": ["broken"]}),
        pytest.raises(InputError, match="--workers") as raised,
    ):
        found(task(), tmp_path / "out.nc", Workers(number=1))
    assert "\n" not in str(raised.value)


def test_a_worker_without_the_package_is_rejected_by_name_at_once(tmp_path):
    """Dask never reports a block that such a worker cannot load."""
    shutil.copy(ROOT / "tests/helpers/worker_jobs.py", tmp_path)
    with (
        foreign_worker(tmp_path, "worm_model", "worm_msgs") as address,
        pytest.raises(InputError, match=r"worker tcp.*cannot import worm_optimizer"),
    ):
        found(task(), tmp_path / "out.nc", Workers(address))
