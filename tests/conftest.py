# SPDX-License-Identifier: Apache-2.0
"""Fixtures for all tests."""

import contextlib
import gc
import itertools
import os
import resource
import signal
import tempfile
import time
import tomllib
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

# Before the first import of messages: fields of a wrong type then fail where they are set.
os.environ.setdefault("ROS_PYTHON_CHECK_FIELDS", "1")
with contextlib.suppress(ImportError):  # ROS is not installed, or the workspace is not built yet
    import worm_model  # noqa: F401 - before NumPy, whose threads it limits
    from worm_msgs import network

    network.bind(os.environ, os.environ.get("RMW_IMPLEMENTATION", "rmw_fastrtps_cpp"))
os.environ.setdefault("MPLBACKEND", "Agg")

ALL = bool(os.environ.get("WORM_ALL_RANDOM_CASES"))  # set by ./worm test --all
# No test is timed: a busy machine is not a failure.
MOST = 100 if ALL else 33
settings.register_profile(
    "untimed", deadline=None, max_examples=MOST, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("untimed")

# A shell ignores SIGINT in its background jobs, and processes that the tests start would inherit that.
signal.signal(signal.SIGINT, signal.default_int_handler)

ROOT = Path(__file__).resolve().parents[1]


class CpuTimes:
    """Processor time of each folder of tests, with the processes that the tests started and awaited, in s."""

    def __init__(self) -> None:
        self.spent: Counter[str] = Counter()
        self.measured_until = 0.0

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_makereport(self, call: pytest.CallInfo):
        """Give the last report of each test the time since the test before: xdist passes it on."""
        report = yield
        if call.when == "teardown":
            now = _cpu_seconds()
            report.user_properties.append(("cpu_seconds", now - self.measured_until))
            self.measured_until = now
        return report

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        spent = dict(report.user_properties).get("cpu_seconds", 0.0)
        self.spent[str(Path(report.nodeid.partition("::")[0]).parent)] += spent

    def pytest_terminal_summary(self, terminalreporter, config: pytest.Config) -> None:
        if config.option.durations is None:  # only runs of whole folders, which ./worm test starts
            return
        committed = tomllib.loads((ROOT / "tests" / "cpu_seconds.toml").read_text())[
            "all" if ALL else "default"
        ]
        terminalreporter.section("processor time of each folder, s (committed)")
        for folder, spent in self.spent.most_common():
            terminalreporter.line(f"{spent:8.1f} ({committed.get(folder, 0.0):.0f})  {folder}")
        terminalreporter.line(f"{self.spent.total():8.1f}  total")


def _cpu_seconds() -> float:
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime


CPU_TIMES = CpuTimes()


def pytest_configure(config: pytest.Config) -> None:
    """Measure the processor times."""
    config.pluginmanager.register(CPU_TIMES)


def pytest_collection_finish() -> None:
    """Let the garbage collector search seldom, and not in what has been imported: its searches took 4 % of the time."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(20_000)
    CPU_TIMES.measured_until = _cpu_seconds()


@pytest.fixture(scope="session")
def shared() -> Path:
    """Return the folder of reference material next to the checkout; skip the test without it."""
    path = ROOT.parent / "shared"
    if not path.is_dir():
        pytest.skip(f"no reference material: {path} does not exist")
    return path


_WORKER = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw"))
# A test must not use the domain of the test before, whose killed processes are still announced, or of another worker.
DOMAINS = itertools.cycle(sorted(range(1, 101), key=lambda domain: (domain - 25 * _WORKER) % 100))


def _free_domain(environment: pytest.MonkeyPatch) -> Iterator[int]:
    domain_coordinator = pytest.importorskip("domain_coordinator", reason="no ROS is installed")
    with (
        domain_coordinator.domain_id(lambda: next(DOMAINS)) as domain,
        tempfile.TemporaryDirectory() as state,
    ):
        environment.setenv("ROS_DOMAIN_ID", str(domain))
        environment.setenv("WORM_STATE_DIRECTORY", state)  # each test has its own emergency stop
        yield domain


@pytest.fixture
def ros_domain(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """Set a free ROS domain in the environment of the test and of all processes that it starts."""
    yield from _free_domain(monkeypatch)


@pytest.fixture(scope="module")
def module_domain() -> Iterator[int]:
    """Set a domain as above for fixtures that the tests of one module share."""
    with pytest.MonkeyPatch.context() as environment:
        yield from _free_domain(environment)
