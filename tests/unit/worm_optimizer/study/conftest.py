# SPDX-License-Identifier: Apache-2.0
"""Workers that the tests of studies share.

Without the optional packages of studies, the tests that need them are skipped.
"""

from __future__ import annotations

from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from study_cases import Here

if TYPE_CHECKING:
    from distributed import LocalCluster

NEEDS_IT = {"test_blocks.py", "test_study_run.py", "test_study_command.py"}


class Absent(pytest.Module):
    """Test module that is not imported."""

    def collect(self):
        pytest.skip("needs pip install --group study", allow_module_level=True)


def pytest_pycollect_makemodule(module_path: Path, parent: pytest.Collector):
    if module_path.name in NEEDS_IT and find_spec("distributed") is None:
        return Absent.from_parent(parent, path=module_path)
    return None


# Without these settings, a cluster that waits needs an eighth of a processor to watch itself.
QUIET = {
    "distributed.worker.profile.enabled": False,
    "distributed.admin.tick.interval": "1s",
    "distributed.admin.system-monitor.interval": "10s",
}


@pytest.fixture(scope="module")  # "package" would keep it until all tests have ended
def cluster() -> Iterator[LocalCluster]:
    """Start two workers in processes of their own, for the tests that start none themselves."""
    import dask
    from distributed import LocalCluster

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
    from worm_optimizer.study import blocks

    here = Here()
    monkeypatch.setattr(blocks, "_computed", here)
    return here
