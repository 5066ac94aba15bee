# SPDX-License-Identifier: Apache-2.0
"""Processor time of exact fronts, requests, margin scans and promises; NSGA-II compared with the exact front."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np

from benchmarks.report import Row, cpu_time
from worm_model.parameters import PAPER, ParameterFile
from worm_msgs.driver_file import read_driver_file
from worm_optimizer.evaluation.servo_limits import limits_of, servo_model
from worm_optimizer.evaluation.task import MarginTask
from worm_optimizer.search import nsga2
from worm_optimizer.search.exact import Resolution, Zoom, exact_front
from worm_optimizer.search.front import (
    RobustFront,
    front_of_task,
    make_front,
    scanned_price,
    waveform_task,
)
from worm_optimizer.search.gait_request import GaitRequest, Objective, select
from worm_optimizer.search.search_settings import Nsga2Settings, Robustness, Settings, Waveform

TITLE = "processor time of exact fronts, requests and scans; NSGA-II compared with the exact front"
SEEDS = range(1, 6)
MARGINS = (0.0, 2e-3, 3.4e-3, 5e-3)
DEFAULTS = Settings()
REPEATS = 3


def _row(what: str, call: Callable[[], object], goal: str, how: str) -> Row:
    return Row(what, f"{cpu_time(call, REPEATS):.2f} s", goal, how)


def _nsga2_row() -> Row:
    found = []
    for margin in MARGINS:
        exact = exact_front(MarginTask(margin=margin), Resolution(), Zoom())
        for seed in SEEDS:
            search = Nsga2Settings(seed=seed)
            found.append(nsga2.compared(exact, nsga2.nsga2_front(exact.task, search)))
    shares = 100.0 * np.array([each.hypervolume_share for each in found])
    excess = 100.0 * max(each.largest_excess_power for each in found)
    missed = sum(bool(each.missed_branches) for each in found)
    value = f"{shares.min():.2f} to {shares.max():.2f} %, up to {excess:.2f} % more power"
    how = f"{len(SEEDS)} seeds at each of {len(MARGINS)} margins; {missed} of them missed a branch"
    return Row("NSGA-II's share of the exact hypervolume", value, "at most 100 %", how)


def _scan_row(initial_length: float) -> Row:
    content = ParameterFile(PAPER.replace(initial_length=initial_length))
    price = scanned_price(content, DEFAULTS, 1)
    cliff = "none" if price.cliff is None else f"{1e3 * price.cliff.margin:.3f} mm"
    how = (
        f"81 margins, cliff at {cliff} ({1e3 * price.closed_form_cliff_margin:.3f} in closed form)"
    )
    return _row("margin scan", lambda: scanned_price(content, DEFAULTS, 1), "2 s", how)


def _limited_rows() -> list[Row]:
    driver = read_driver_file(Path(__file__).parents[1] / "src/worm_driver/config/driver.yaml")
    limits = limits_of(driver, servo_model("XM430-W350"), None)
    task, limited = MarginTask(limits=limits), dataclasses.replace(DEFAULTS, limits=limits)
    return [
        _row(
            "front under a servo's limits",
            lambda: exact_front(task, Resolution(), Zoom()),
            "1 s",
            "margin 0, peak force, power and motor load of every moving gait",
        ),
        _row(
            "margin scan under a servo's limits",
            lambda: scanned_price(ParameterFile(), limited, 1),
            "4 s",
            "the same at 81 margins",
        ),
    ]


def _shaped_row(margin: float) -> Row:
    shaped = dataclasses.replace(DEFAULTS, margin=margin, waveform=Waveform.SHAPED)
    task = MarginTask(margin=margin)
    how = f"margin {1e3 * margin:g} mm, over pretension, shares and profile"
    return _row(
        "front of shaped gaits",
        lambda: front_of_task(waveform_task(task, shaped), DEFAULTS.resolution),
        "20 times that of the sinusoid",
        how,
    )


def _promise_row(kind: Robustness, goal: str, how: str) -> Row:
    settings = dataclasses.replace(DEFAULTS, robustness=kind)
    return _row(f"front, {kind.value}", lambda: make_front(ParameterFile(), settings, 1), goal, how)


def _request_row(front: RobustFront) -> Row:
    request = GaitRequest(Objective.MIN_POWER_AT_SPEED, 0.004)
    how = "4 mm/s, with the predictions of its gait"
    return _row("request at a speed", lambda: select(front, request), "", how)


def run() -> list[Row]:
    """Measure with the kernel loaded."""
    front = make_front(ParameterFile(), dataclasses.replace(DEFAULTS, margin=3.4e-3), 1)
    task = MarginTask(margin=3.4e-3)
    return [
        _row(
            "front",
            lambda: exact_front(task, Resolution(), Zoom()),
            "0.5 s",
            f"margin 3.4 mm, {len(front.gaits)} gaits, all edges and the three minima",
        ),
        _request_row(front),
        _scan_row(0.2952),
        _scan_row(0.2941),
        *_limited_rows(),
        *(_shaped_row(margin) for margin in (0.0, 3.4e-3)),
        _promise_row(Robustness.CHANCE, "10 s", "200 draws, success of three gaits over 500"),
        _promise_row(Robustness.ANY_PHASE, "10 s", "64 phases, success of three gaits over 500"),
        _nsga2_row(),
    ]
