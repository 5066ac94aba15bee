# SPDX-License-Identifier: Apache-2.0
"""Response times of the optimizer node: the first request after its start, and later ones."""

from __future__ import annotations

import os
import tempfile
import time
from pathlib import Path

import numpy as np
from rclpy.client import Client

from benchmarks.report import Row
from tests.helpers.harness import Probe, Processes
from worm_model.parameters import ParameterFile
from worm_msgs.srv import RequestGait
from worm_optimizer.nodes.optimizer_messages import fill_response
from worm_optimizer.search.front import RobustFront, make_front
from worm_optimizer.search.gait_request import request_of, select
from worm_optimizer.search.search_settings import Settings

TITLE = "latency of request_gait through the middleware (needs the built workspace)"
REQUESTS = 200
PAUSE_S = 0.005  # between requests: a queue of them would measure itself
GOAL = ""


def latencies(probe: Probe, client: Client, count: int) -> np.ndarray:
    """Return round-trip times in ms, for requests of every kind in turn."""
    times = np.empty(count)
    for k in range(count):
        request = RequestGait.Request(objective=k % 5, speed=0.004, power=3.0, direction=1)
        start = time.perf_counter()
        answer = probe.result(client.call_async(request), "answer")
        times[k] = 1e3 * (time.perf_counter() - start)
        time.sleep(PAUSE_S)
        assert answer.success, answer.message
    return times


def answers(front: RobustFront, count: int) -> np.ndarray:
    """Return durations of the node's callback in ms, for requests of every kind in turn."""
    times = np.empty(count)
    for k in range(count):
        start = time.perf_counter()
        answer = select(front, request_of(k % 5, 0.004, 3.0))
        fill_response(RequestGait.Response(), answer)
        times[k] = 1e3 * (time.perf_counter() - start)
    return times


def _row(what: str, times: np.ndarray, how: str) -> Row:
    middle, most = np.percentile(times, [50.0, 99.0])
    return Row(what, f"p50 {middle:.2f} ms, p99 {most:.2f} ms", GOAL, how)


def _measure(processes: Processes, probe: Probe) -> list[Row]:
    processes.start_node("worm_optimizer", "optimizer_node", margin_m=0.0034)
    client = probe.node.create_client(RequestGait, "request_gait")
    probe.wait_for(client.service_is_ready, "service")
    first = latencies(probe, client, 1)
    idle = latencies(probe, client, REQUESTS)
    front = make_front(ParameterFile(), Settings(margin=0.0034), 1)
    return [
        Row("first request", f"{first[0]:.0f} ms", "1 s", "from when the service is there"),
        _row("answer alone", answers(front, REQUESTS), "in this process, without the middleware"),
        _row("request", idle, f"{REQUESTS} round trips, {1e3 * PAUSE_S:g} ms apart"),
    ]


def run() -> list[Row]:
    """Measure in a separate ROS domain."""
    domain = 100 + os.getpid() % 100
    os.environ["ROS_DOMAIN_ID"] = str(domain)
    with tempfile.TemporaryDirectory() as name, (processes := Processes(Path(name))):
        probe = Probe(domain)
        try:
            return _measure(processes, probe)
        finally:
            probe.close()
