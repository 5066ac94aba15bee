# SPDX-License-Identifier: Apache-2.0
"""Repeated demos: how many succeed, and how much their results differ."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time

import numpy as np

from benchmarks.report import Row
from worm_optimizer.operation.processes import executable_command

TITLE = (
    "ten demos in a row: successes, and the spread of their figures (ten minutes; more with --busy)"
)
DEMOS = 10
DOMAIN = 93


def run() -> list[Row]:
    """Run the demos with one seed and return the rows."""
    figures, seconds, failures = [], [], []
    with tempfile.TemporaryDirectory() as bags:
        command = [*executable_command("worm_optimizer", "demo"), "--json", "--bags", bags]
        environment = {**os.environ, "ROS_DOMAIN_ID": str(DOMAIN)}
        for number in range(DEMOS):
            start = time.monotonic()
            done = subprocess.run(
                command, env=environment, capture_output=True, text=True, check=False
            )
            seconds.append(time.monotonic() - start)
            if done.returncode:
                failures.append(done.stderr.strip().splitlines()[-1])
            else:
                figures.append(json.loads(done.stdout.splitlines()[-1]))
            repeats = done.stderr.count("once more")
            sys.stderr.write(
                f"demo {number + 1}: status {done.returncode}, {seconds[-1]:.0f} s, repeats {repeats}\n"
            )
    rows = [
        Row("demos that succeed", f"{len(figures)} of {DEMOS}", f"{DEMOS} of {DEMOS}", "one seed"),
        Row("time of a demo", f"{min(seconds):.0f} to {max(seconds):.0f} s", "", "by the clock"),
        *(Row("failure", failure, "none", "") for failure in failures),
    ]
    for source in ("measured", "twin"):
        for key in ("speed", "power", "cost_of_transport"):
            values = np.array([figure[source][key] for figure in figures])
            if values.size:
                spread = np.ptp(values) / abs(values.mean())
                what = f"mean {values.mean():.5g}, from least to most"
                rows.append(Row(f"{key}, {source}", f"{100 * spread:.3f} %", "the same", what))
    return rows
