# SPDX-License-Identifier: Apache-2.0
"""Fixtures of the unit tests."""

import os
from collections.abc import Iterator

import pytest


@pytest.fixture(scope="session", autouse=True)
def _one_processor_per_worker() -> Iterator[None]:
    """Threads that pass Python's lock from processor to processor need a third more processor time."""
    worker = os.environ.get("PYTEST_XDIST_WORKER")
    allowed = os.sched_getaffinity(0)
    if worker is not None:
        os.sched_setaffinity(0, {sorted(allowed)[int(worker[2:]) % len(allowed)]})
    yield
    os.sched_setaffinity(0, allowed)
