# SPDX-License-Identifier: Apache-2.0
"""Fixtures of the unit tests."""

import os
import sys
from collections.abc import Iterator
from types import ModuleType

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


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    """Return a function that runs the command of a module and returns exit status, standard output and error."""

    def call(module: ModuleType, *arguments: object) -> tuple[object, str, str]:
        monkeypatch.setattr(sys, "argv", ["command", *map(str, arguments)])
        try:
            status = module.main()
        except SystemExit as end:  # of argparse
            status = end.code
        return status, *capsys.readouterr()

    return call
