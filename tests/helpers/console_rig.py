# SPDX-License-Identifier: Apache-2.0
"""The console as a process, and what the tests do on its pages in a browser."""

import re
import shutil
import socket
from pathlib import Path

import pytest
from harness import Processes

from worm_optimizer.operation.processes import executable_command

NEEDED = "needs pip install --group console --group test"
pytest.importorskip("nicegui", reason=NEEDED)
sync_api = pytest.importorskip("playwright.sync_api", reason=NEEDED)
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
NEEDS_BROWSER = [
    pytest.mark.skipif(CHROMIUM is None, reason="no Chromium: apt install chromium"),
    pytest.mark.timeout(3600),
    pytest.mark.night,
]
TIMEOUT_S = 600.0  # includes the compilation of a kernel and a report, both with low priority on a busy machine
BAGS = Path(__file__).parents[2] / "bags"


def free_port() -> int:
    with socket.socket() as tried:
        tried.bind(("127.0.0.1", 0))
        return tried.getsockname()[1]


class Console:
    """The console's process, its address and its folder of bags."""

    def __init__(self, processes: Processes, folder: Path, *arguments: str) -> None:
        self.bags, self.temporary = folder / "bags", folder / "tmp"
        self.temporary.mkdir()
        self.processes = processes.processes
        port = free_port()
        self.address = f"http://127.0.0.1:{port}/"
        options = ["--port", str(port), "--bags", str(self.bags), *arguments]
        options += ["--control-timeout", str(TIMEOUT_S)]  # a page on a busy machine keeps control
        command = executable_command("worm_optimizer", "console")
        # with PYTEST_CURRENT_TEST in its environment, NiceGUI tests itself
        environment = ["env", "-u", "PYTEST_CURRENT_TEST", f"TMPDIR={self.temporary}"]
        command = [*environment, *command, *options]
        self.process = processes.start(f"console_{port}", command)
        self.process.wait_for_line(re.escape(self.address), TIMEOUT_S)

    def open(self, page: "sync_api.Page") -> None:
        """Open the page; the server may not listen yet."""
        for _ in range(100):
            try:
                page.goto(self.address)
                break
            except sync_api.Error:
                assert self.process.exit_code is None, self.process.output()
                page.wait_for_timeout(200)


def press(page: "sync_api.Page", name: str) -> None:
    page.get_by_role("button", name=name, exact=True).click()


def state(page: "sync_api.Page") -> "sync_api.Locator":
    """Return the state of the driver."""
    return page.locator("#state")


def status(page: "sync_api.Page") -> "sync_api.Locator":
    """Return the present command or the latest message."""
    return page.locator("#message")
