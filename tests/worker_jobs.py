# SPDX-License-Identifier: Apache-2.0
"""Jobs for a worker; here, as its process must find them, whatever pytest calls the module of the test."""

import os
import signal
import time
from dataclasses import dataclass

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
