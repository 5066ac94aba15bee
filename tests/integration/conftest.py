# SPDX-License-Identifier: Apache-2.0
"""Fixtures of the tests with real processes over real DDS."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from harness import Probe, Processes


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item):
    """Show the output of the started processes with a failure."""
    report = yield
    if report.failed:
        page = getattr(item, "funcargs", {}).get("page")
        if page is not None and not page.is_closed():
            report.sections.append(("text of the page", page.locator("body").inner_text()))
        given = getattr(item, "funcargs", {}).values()
        shared = [getattr(value, "processes", None) for value in given]  # by a lab, for example
        groups = {group for group in (*given, *shared) if isinstance(group, Processes)}
        report.sections += [
            (f"output of {process.name}", process.output())
            for group in groups
            for process in group.processes.values()
        ]
    return report


@pytest.fixture
def processes(ros_domain: int, tmp_path: Path) -> Iterator[Processes]:
    """Start installed executables, and end them after the test."""
    folder = tmp_path / "logs"
    folder.mkdir()
    with Processes(folder) as group:
        yield group


@pytest.fixture
def probe(ros_domain: int) -> Iterator[Probe]:
    """Create a node of the test with subscriptions, and service and action calls with deadlines."""
    probe = Probe(ros_domain)
    yield probe
    probe.close()
