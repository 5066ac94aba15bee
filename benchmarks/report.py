# SPDX-License-Identifier: Apache-2.0
"""Result of a benchmark, and its output as a table."""

from __future__ import annotations

import os
import platform
import statistics
import time
from collections.abc import Callable
from dataclasses import astuple, dataclass
from pathlib import Path
from textwrap import indent

from worm_model.text_table import text_table


@dataclass(frozen=True)
class Row:
    """Measured quantity: its name, its value with the unit, the goal, and the method."""

    what: str
    value: str
    goal: str
    how: str


def machine() -> str:
    """Return a description of the machine in one line."""
    model = platform.processor() or platform.machine()
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.exists():
        names = [line for line in cpuinfo.read_text().splitlines() if line.startswith("model name")]
        model = names[0].split(":", 1)[1].strip() if names else model
    load = os.getloadavg()[0]
    return f"{model}, {os.cpu_count()} cores, load {load:.1f}, Python {platform.python_version()}"


def print_rows(title: str, rows: list[Row]) -> None:
    """Print the results of one benchmark as a table."""
    heads = ("quantity", "value", "goal", "method")
    print(f"\n{title}\n{indent(text_table([heads, *map(astuple, rows)]), '  ')}")


def cpu_time(call: Callable[[], object], repeats: int) -> float:
    """Return the median processor time of a call in s, over all threads of this process."""
    times = []
    for _ in range(repeats):
        start = time.process_time()
        call()
        times.append(time.process_time() - start)
    return statistics.median(times)


def wall_time(call: Callable[[], object], repeats: int) -> float:
    """Return the median duration of a call in s."""
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        call()
        times.append(time.perf_counter() - start)
    return statistics.median(times)
