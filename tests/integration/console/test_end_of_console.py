# SPDX-License-Identifier: Apache-2.0
"""Signals end the console and all that it started."""

import os
import signal
from pathlib import Path

import pytest
from console_rig import TIMEOUT_S, Console
from harness import Processes


@pytest.mark.parametrize(
    ("line", "signals"),
    [
        ("Ctrl-C ends it", [signal.SIGTERM]),
        ("starting virtual_robot", [signal.SIGINT, signal.SIGINT]),
        ("all nodes run$", [signal.SIGINT, signal.SIGTERM]),
    ],
)
def test_a_signal_at_any_moment_ends_it_and_all_that_it_started(
    line: str, signals: list[signal.Signals], processes: Processes, tmp_path: Path
):
    console = Console(processes, tmp_path, "--virtual", "--set", f"directory={tmp_path / 'robot'}")
    console.process.wait_for_line(line, TIMEOUT_S)
    for number in signals:
        console.process.signal(number)
    assert console.process.wait(TIMEOUT_S) == 0
    assert "Traceback" not in console.process.output()
    assert [path.name for path in console.temporary.iterdir()] == []
    place = os.fsencode(tmp_path / "robot")
    commands = [path.read_bytes() for path in Path("/proc").glob("[0-9]*/cmdline")]
    assert not any(place in command for command in commands)
