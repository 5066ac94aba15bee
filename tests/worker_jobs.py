# SPDX-License-Identifier: Apache-2.0
"""Jobs for workers; here, as their processes must find them, whatever pytest calls the module of the test."""

import os
import signal
import time
from dataclasses import dataclass
from pathlib import Path

from worm_optimizer.search.front import Progress, Report
from worm_optimizer.search.optimizer_errors import OptimizerError


@dataclass(frozen=True)
class Steps:
    """Reports a number of steps and returns the process that it ran in."""

    count: int

    def run(self, report: Report) -> int:
        for step in range(self.count):
            report(Progress((step + 1) / self.count, f"step {step}"))
        return os.getpid()


@dataclass(frozen=True)
class Endless:
    """Says which process it is and never ends."""

    def run(self, report: Report) -> object:
        report(Progress(0.0, str(os.getpid())))
        while True:
            time.sleep(1.0)


@dataclass(frozen=True)
class Refusing:
    def run(self, report: Report) -> object:
        raise OptimizerError("nothing moves")


@dataclass(frozen=True)
class Dying:
    def run(self, report: Report) -> object:
        os.kill(os.getpid(), signal.SIGKILL)
        return None


def suicide(place: int, marker: str) -> int:
    """Ends its worker the first time it is called."""
    if not Path(marker).exists():
        Path(marker).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return place


def refuse(place: int) -> int:
    raise ValueError(f"piece {place}")
