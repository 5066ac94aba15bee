# SPDX-License-Identifier: Apache-2.0
"""How long the optimizer node takes to answer a request, at rest and while its worker computes."""

from __future__ import annotations

import os
import tempfile
import time
from pathlib import Path

import numpy as np
from rclpy.client import Client

from benchmarks.report import Row
from tests.harness import Probe, Processes
from worm_model.parameters import ParameterFile
from worm_msgs.action import OptimizeGaits
from worm_msgs.srv import RequestGait
from worm_optimizer.nodes.optimizer_messages import fill_response
from worm_optimizer.search.cache import Cache
from worm_optimizer.search.front import RobustFront, load_current
from worm_optimizer.search.gait_request import answer, request_of
from worm_optimizer.search.search_settings import Settings

TITLE = "latency of request_gait through the middleware (needs the built workspace)"
REQUESTS = 2000
PAUSE_S = 0.005  # between requests: a queue of them would measure itself
GOAL = "p99 below 5 ms"


def latencies(probe: Probe, client: Client, count: int) -> np.ndarray:
    """Times of round trips in ms, requests of every kind in turn."""
    times = np.empty(count)
    for k in range(count):
        request = RequestGait.Request(objective=k % 5, speed=0.004, power=3.0, direction=1)
        start = time.perf_counter()
        told = probe.result(client.call_async(request), "answer")
        times[k] = 1e3 * (time.perf_counter() - start)
        time.sleep(PAUSE_S)
        assert told.success, told.message
    return times


def answers(front: RobustFront, count: int) -> np.ndarray:
    """Times in ms of what the node's callback does, requests of every kind in turn."""
    times = np.empty(count)
    for k in range(count):
        start = time.perf_counter()
        told = answer({1: front}, {}, 1, request_of(k % 5, 0.004, 3.0))
        fill_response(RequestGait.Response(), told)
        times[k] = 1e3 * (time.perf_counter() - start)
    return times


def _row(what: str, times: np.ndarray, how: str) -> Row:
    middle, most = np.percentile(times, [50.0, 99.0])
    return Row(what, f"p50 {middle:.2f} ms, p99 {most:.2f} ms", GOAL, how)


def _wait_for_front(probe: Probe, client: Client) -> None:
    probe.wait_for(client.service_is_ready, "service")
    request = RequestGait.Request(objective=1, direction=1)

    def answered() -> bool:
        time.sleep(0.2)
        return probe.result(client.call_async(request), "answer").success

    probe.wait_for(answered, "front", timeout_s=120.0)


def _measure(processes: Processes, probe: Probe, folder: Path) -> list[Row]:
    cache = folder / "cache"
    processes.start_node("worm_optimizer", "optimizer_node", cache_directory=cache, margin_m=0.0034)
    client = probe.node.create_client(RequestGait, "request_gait")
    _wait_for_front(probe, client)
    front = load_current(ParameterFile(), Settings(margin=0.0034), 1, Cache.at(cache))
    assert front is not None, "the node has not stored its front"
    idle = latencies(probe, client, REQUESTS)
    goal = OptimizeGaits.Goal(margin=0.002, direction=1, generations=100_000)
    handle = probe.send_goal(OptimizeGaits, "optimize_gaits", goal)
    busy = latencies(probe, client, REQUESTS)
    start = time.perf_counter()
    probe.result(handle.cancel_goal_async(), "answer to the cancel")
    probe.result(handle.get_result_async(), "result")
    cancel = 1e3 * (time.perf_counter() - start)
    return [
        _row("answer alone", answers(front, REQUESTS), "in this process, without the middleware"),
        _row("request, node at rest", idle, f"{REQUESTS} round trips, {1e3 * PAUSE_S:g} ms apart"),
        _row("request, worker computing", busy, "the same during an endless optimisation"),
        Row("cancel to result", f"{cancel:.0f} ms", "at once", "of that optimisation"),
    ]


def run() -> list[Row]:
    """Measures on a ROS domain of its own."""
    domain = 100 + os.getpid() % 100
    os.environ["ROS_DOMAIN_ID"] = str(domain)
    with tempfile.TemporaryDirectory() as name, Processes(Path(name)) as processes:
        probe = Probe(domain)
        try:
            return _measure(processes, probe, Path(name))
        finally:
            probe.close()
