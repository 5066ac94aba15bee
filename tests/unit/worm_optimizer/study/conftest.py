# SPDX-License-Identifier: Apache-2.0
"""Workers that the tests of studies share."""

from collections.abc import Iterator

import dask
import pytest
from distributed import LocalCluster
from study_cases import Here

from worm_optimizer.study import blocks

# Without these settings, a cluster that waits needs an eighth of a processor to watch itself.
QUIET = {
    "distributed.worker.profile.enabled": False,
    "distributed.admin.tick.interval": "1s",
    "distributed.admin.system-monitor.interval": "10s",
}


@pytest.fixture(scope="module")  # "package" would keep it until all tests have ended
def cluster() -> Iterator[LocalCluster]:
    """Start two workers in processes of their own, for the tests that start none themselves."""
    with (
        dask.config.set(QUIET),
        LocalCluster(
            n_workers=2,
            threads_per_worker=1,
            processes=True,
            dashboard_address="127.0.0.1:0",
            memory_limit=0,
        ) as running,
    ):
        yield running


@pytest.fixture
def here(monkeypatch) -> Here:
    """Compute in this process."""
    here = Here()
    monkeypatch.setattr(blocks, "_computed", here)
    return here
