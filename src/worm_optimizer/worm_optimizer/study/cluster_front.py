# SPDX-License-Identifier: Apache-2.0
"""The long work of a front whose gaits promise their grooves, on the workers of a Dask cluster."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial

from distributed import Client

from worm_optimizer.search.front import Report, RobustFront, make_front
from worm_optimizer.search.optimizer_errors import OptimizerError
from worm_optimizer.search.task import Array, Points, Task
from worm_optimizer.search.worker import FrontJob
from worm_optimizer.study.engine import ClusterError, LostError, connected, spread

_log = logging.getLogger("worm_optimizer.study")


@dataclass(frozen=True)
class ClusterFrontJob(FrontJob):
    """Computes a front with the workers that a Dask scheduler at an address knows, and stores it in the cache."""

    scheduler: str

    def run(self, report: Report) -> RobustFront:
        """See `front.make_front`; raises `OptimizerError` also where the cluster cannot be used or is lost."""
        try:
            with connected(self.scheduler, 0) as client:
                evaluate = partial(_by_workers, client)
                return make_front(
                    self.content, self.settings, self.direction, self.cache, report, evaluate
                )
        except (ClusterError, LostError) as error:
            raise OptimizerError(f"the cluster at {self.scheduler}: {error}") from None


def _by_workers(
    client: Client, task: Task, parts: Sequence[tuple[Array, Array]]
) -> Iterator[Points]:
    """Every part by a worker; what comes early waits, so that the order is that of the parts."""
    early: dict[int, Points] = {}
    wanted = 0
    for place, points in spread(client, task.points, parts, _log.warning):
        early[place] = points
        while wanted in early:
            yield early.pop(wanted)
            wanted += 1
