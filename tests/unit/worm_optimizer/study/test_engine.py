# SPDX-License-Identifier: Apache-2.0
"""Real workers in processes of their own, killed as by the kernel."""

import contextlib
import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import dask
import pytest
from distributed import Client, LocalCluster
from study_cases import SMALL, contents
from worker_jobs import reject, suicide

from worm_optimizer.study.engine import ClusterError, LostError, connected, spread
from worm_optimizer.study.store import locked_store
from worm_optimizer.study.study_file import parse_study
from worm_optimizer.study.study_run import Workers, run_study

ROOT = Path(__file__).resolve().parents[4]
STUDY = parse_study(SMALL, Path())
COMMAND = [
    sys.executable,
    "-c",
    "import sys; from worm_optimizer.commands.study import main; sys.exit(main())",
]
pytestmark = pytest.mark.timeout(300)


@pytest.fixture(scope="module")
def whole(tmp_path_factory, cluster) -> Path:
    """Return the small study, computed without failures."""
    path = tmp_path_factory.mktemp("whole") / "study.zarr"
    counts = run_study(STUDY, path, Workers(cluster.scheduler_address), print, lambda done: None)
    assert (counts.points, counts.done, counts.failed) == (6, 6, 3)
    return path


def until(condition: Callable[[], object], seconds: float = 120.0) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, "it did not happen in time"
        time.sleep(0.05)


def test_what_a_killed_worker_had_is_done_by_another(cluster, tmp_path):
    with connected(cluster.scheduler_address, 0, print) as client:
        pieces = [(k, str(tmp_path / "killed")) for k in range(4)]
        found = dict(spread(client, suicide, pieces, print))
    assert (tmp_path / "killed").exists()
    assert found == {k: k for k in range(4)}


def test_an_error_of_the_work_is_passed_on(cluster):
    with (
        connected(cluster.scheduler_address, 0, print) as client,
        pytest.raises(ValueError, match="piece"),
    ):
        list(spread(client, reject, [(1,)], print))


def test_a_killed_client_goes_on_where_it_was_with_the_same_bytes(whole, tmp_path, cluster):
    study, output = tmp_path / "study.yaml", tmp_path / "study.zarr"
    study.write_text(SMALL)
    command = [
        *COMMAND,
        str(study),
        "--output",
        str(output),
        "--scheduler",
        cluster.scheduler_address,
    ]

    def finished() -> int:
        return sum(1 for file in output.glob("speed/*") if file.name[0].isdigit())

    client = subprocess.Popen(command, stderr=subprocess.DEVNULL)
    until(lambda: finished() >= 1 or client.poll() is not None)
    client.kill()
    client.wait()
    done = subprocess.run([*command, "--json"], capture_output=True, text=True, check=True)
    assert '"done": 6, "failed": 3' in done.stdout
    assert contents(output) == contents(whole)


def test_a_killed_scheduler_is_reported_and_the_study_continues_elsewhere(whole, tmp_path, cluster):
    output = tmp_path / "study.zarr"
    own = subprocess.Popen(
        [sys.executable, "-m", "distributed.cli.dask_scheduler", "--port", "0", "--no-dashboard"]
        + ["--scheduler-file", str(tmp_path / "address.json")],
        stderr=subprocess.DEVNULL,
    )
    until((tmp_path / "address.json").exists)
    address = json.loads((tmp_path / "address.json").read_text())["address"]
    worker = subprocess.Popen(
        [
            sys.executable,
            "-m",
            "distributed.cli.dask_worker",
            address,
            "--no-nanny",
            "--nthreads",
            "1",
        ]
        + ["--no-dashboard"],
        stderr=subprocess.DEVNULL,
    )

    def kill_after_the_first(done: float) -> None:
        if done > 0.0:
            own.kill()

    try:
        with pytest.raises(LostError, match=r"of 6 points are in .*repeat the command"):
            run_study(STUDY, output, Workers(address), print, kill_after_the_first)
    finally:
        for process in (own, worker):
            process.kill()
            process.wait()
    with locked_store(output, STUDY) as store:
        assert 1 <= store.counts()[0] < 6
    run_study(STUDY, output, Workers(cluster.scheduler_address), print, lambda done: None)
    assert contents(output) == contents(whole)


@contextlib.contextmanager
def foreign_worker(folder: Path, *packages: str) -> Iterator[Client]:
    """Return a client whose only worker runs in ``folder`` with these packages."""
    path = os.pathsep.join([str(folder), *(str(ROOT / "src" / package) for package in packages)])
    with (
        LocalCluster(n_workers=0, dashboard_address="127.0.0.1:0") as empty,
        subprocess.Popen(
            [sys.executable, "-m", "distributed.cli.dask_worker", empty.scheduler_address]
            + ["--no-nanny", "--nthreads", "1", "--no-dashboard"],
            cwd=folder,  # one of our folders would precede the path
            env={**os.environ, "PYTHONPATH": path},
            stderr=subprocess.DEVNULL,
        ) as worker,
        Client(empty) as client,
    ):
        try:
            client.wait_for_workers(1, timeout=120)
            yield client
        finally:
            worker.kill()


def test_a_worker_of_another_version_is_rejected_by_name(tmp_path):
    package = tmp_path / "worm_optimizer"
    shutil.copytree(ROOT / "src/worm_optimizer/worm_optimizer", package)
    with (package / "study/point.py").open("a") as file:
        file.write("\n# another version\n")
    with foreign_worker(tmp_path, "worm_model", "worm_msgs") as client:
        name = next(iter(client.scheduler_info(n_workers=-1)["workers"]))
        with pytest.raises(ClusterError, match=f"worker {name}.*another version"):
            list(spread(client, reject, [(1,)], print))


def test_a_worker_without_the_packages_is_rejected_by_name(tmp_path):
    with foreign_worker(tmp_path) as client:
        name = next(iter(client.scheduler_info(n_workers=-1)["workers"]))
        with pytest.raises(ClusterError, match=f"worker {name}.*cannot import"):
            list(spread(client, reject, [(1,)], print))


def test_no_scheduler_is_one_line():
    with (
        pytest.raises(ClusterError, match="no Dask scheduler answers at tcp"),
        connected("tcp://127.0.0.1:1", 0, print),
    ):
        pass


def test_workers_that_do_not_start_are_one_line(tmp_path, monkeypatch):
    (tmp_path / "broken.py").write_text("raise RuntimeError('broken on purpose')\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    with (
        dask.config.set({"distributed.worker.preload": ["broken"]}),
        pytest.raises(ClusterError, match="do not start") as raised,
        connected("", 1, print),
    ):
        pass
    assert "\n" not in str(raised.value)
