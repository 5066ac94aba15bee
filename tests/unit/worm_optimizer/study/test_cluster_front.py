# SPDX-License-Identifier: Apache-2.0
"""A front whose gaits are judged by workers in processes of their own, against the same one computed here."""

import dataclasses
import pickle
from collections.abc import Iterator
from pathlib import Path

import pytest
from distributed import LocalCluster

from worm_model.parameters import ParameterFile
from worm_optimizer.search.cache import Cache
from worm_optimizer.search.front import Progress, RobustFront
from worm_optimizer.search.gait_map import MapSettings
from worm_optimizer.search.optimizer_errors import OptimizerError
from worm_optimizer.search.search_settings import Robustness, Settings, settings_of
from worm_optimizer.search.worker import FrontJob
from worm_optimizer.study.cluster_front import ClusterFrontJob

pytestmark = pytest.mark.timeout(300)
SMALL = {"population": 20, "generations": 3, "samples": 20, "kept_gaits": 12}


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    with LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address="127.0.0.1:0", memory_limit=0
    ) as cluster:
        yield cluster.scheduler_address


def asked(folder: Path, robustness: Robustness) -> tuple[ParameterFile, Settings, int, Cache]:
    settings = dataclasses.replace(
        settings_of(SMALL), robustness=robustness, map=MapSettings(21, 9, 2e-4, 0)
    )
    return ParameterFile(), settings, 1, Cache.at(folder)


def numbers(front: RobustFront) -> list[float]:
    rows = [dataclasses.astuple(gait) for gait in front.predictions]
    return [front.margin, front.hypervolume_share, *(value for row in rows for value in row)]


@pytest.mark.parametrize("robustness", [Robustness.CHANCE, Robustness.ANY_PHASE])
def test_the_workers_front_is_the_one_computed_here(address, tmp_path, robustness):
    told: list[Progress] = []
    job = ClusterFrontJob(*asked(tmp_path / "cluster", robustness), address)
    theirs = pickle.loads(pickle.dumps(job)).run(told.append)  # as the node hands it to its worker
    mine = FrontJob(*asked(tmp_path / "here", robustness)).run(lambda _: None)
    # the simulator is compiled anew where a worker has it from another folder: last digits may differ
    assert numbers(theirs) == pytest.approx(numbers(mine), rel=1e-9, nan_ok=True)
    assert (theirs.reason, theirs.source) == (mine.reason, mine.source)
    fractions = [progress.fraction for progress in told]
    assert fractions == sorted(fractions)
    assert sum("gaits judged" in progress.doing for progress in told) >= 2
    assert [path.name for path in sorted((tmp_path / "cluster").iterdir())] == [
        path.name for path in sorted((tmp_path / "here").iterdir())
    ]


def test_a_scheduler_that_does_not_answer_is_one_line(tmp_path):
    job = ClusterFrontJob(*asked(tmp_path, Robustness.CHANCE), "tcp://127.0.0.1:9")
    with pytest.raises(
        OptimizerError, match=r"^the cluster at tcp://127.0.0.1:9: no Dask scheduler"
    ):
        job.run(lambda _: None)
