# SPDX-License-Identifier: Apache-2.0
"""Fixtures for all tests."""

import contextlib
import gc
import itertools
import os
import signal
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

# Before any message is imported: fields of a wrong type fail where they are set.
os.environ.setdefault("ROS_PYTHON_CHECK_FIELDS", "1")
with contextlib.suppress(ImportError):  # no ROS is installed, or nothing is built yet
    from worm_msgs import network

    network.bind(os.environ, os.environ.get("RMW_IMPLEMENTATION", "rmw_fastrtps_cpp"))
os.environ.setdefault("MPLBACKEND", "Agg")

# No test is timed: a busy machine is not a failure.
settings.register_profile("untimed", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("untimed")

# A shell ignores SIGINT in what it runs in the background, and what the tests start would inherit that.
signal.signal(signal.SIGINT, signal.default_int_handler)

ROOT = Path(__file__).resolve().parents[1]


def pytest_collection_finish() -> None:
    """Let the garbage collector search seldom, and not in what has been imported: its searches took 4 % of the time."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(20_000)


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder of reference material beside the checkout; a test is skipped without it."""
    path = ROOT.parent / "shared"
    if not path.is_dir():
        pytest.skip(f"no reference material: {path} does not exist")
    return path


_WORKER = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw"))
# No test has its predecessor's domain, whose killed processes are still announced, nor one of another worker's.
DOMAINS = itertools.cycle(sorted(range(1, 101), key=lambda domain: (domain - 25 * _WORKER) % 100))


def _free_domain(environment: pytest.MonkeyPatch) -> Iterator[int]:
    domain_coordinator = pytest.importorskip("domain_coordinator", reason="no ROS is installed")
    with (
        domain_coordinator.domain_id(lambda: next(DOMAINS)) as domain,
        tempfile.TemporaryDirectory() as state,
    ):
        environment.setenv("ROS_DOMAIN_ID", str(domain))
        environment.setenv("WORM_STATE_DIRECTORY", state)  # a test's emergency stop is its own
        yield domain


@pytest.fixture
def ros_domain(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """A free ROS domain, in the environment of the test and of all that it starts."""
    yield from _free_domain(monkeypatch)


@pytest.fixture(scope="module")
def module_domain() -> Iterator[int]:
    """The same for fixtures that the tests of one module share."""
    with pytest.MonkeyPatch.context() as environment:
        yield from _free_domain(environment)
