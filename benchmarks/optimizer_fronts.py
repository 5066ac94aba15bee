# SPDX-License-Identifier: Apache-2.0
"""NSGA-II against the exhaustive map, the margin scan, and what a new parameter file costs."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks.report import Row
from worm_model.parameters import PAPER, ParameterFile
from worm_optimizer.search.cache import Cache
from worm_optimizer.search.certificate import CertifiedFront, certified_front
from worm_optimizer.search.front import make_front
from worm_optimizer.search.price_of_robustness import find_cliff, price_of_robustness, scan
from worm_optimizer.search.search_settings import Settings
from worm_optimizer.search.servo_limits import limits_of, load_driver_file, servo_model
from worm_optimizer.search.task import MarginTask

TITLE = "certified fronts, the margin scan, a cold start"
SEEDS = range(1, 11)
MARGINS = (0.0, 2e-3, 3.4e-3, 5e-3)
DEFAULTS = Settings()


def certify(margin: float, seed: int) -> CertifiedFront:
    """A front with the default settings but for the seed."""
    search = type(DEFAULTS.search)(seed=seed)
    return certified_front(MarginTask(margin=margin), search, DEFAULTS.map, lambda _: None)


def _share_row() -> Row:
    fronts = [certify(margin, seed) for margin in MARGINS for seed in SEEDS]
    shares = np.array([front.hypervolume_share for front in fronts])
    missed = sum(bool(front.missed_branches) for front in fronts)
    told = f"{100 * shares.min():.2f} % least, {100 * np.median(shares):.2f} % median"
    how = f"{len(SEEDS)} seeds at each of {len(MARGINS)} margins; {missed} of them missed a branch"
    return Row("hypervolume share of NSGA-II", told, "99.5 %", how)


def _scan_row(initial_length: float) -> Row:
    parameters = PAPER.replace(initial_length=initial_length)
    start = time.perf_counter()
    margins = DEFAULTS.scan.margins()
    points = list(scan(MarginTask(parameters), DEFAULTS.map, margins))
    price = price_of_robustness(points, parameters)
    seconds = time.perf_counter() - start
    cliff = (
        f"{1e3 * price.margin:.1f} mm ({1e3 * price.closed_form_cliff_margin:.2f} in closed form)"
    )
    how = f"{margins.size} margins at L0 = {initial_length} m; cliff at {cliff}"
    return Row("margin scan", f"{seconds:.1f} s", "60 s", how)


def _limited_scan_row() -> Row:
    driver = load_driver_file(Path(__file__).parents[1] / "src/worm_driver/config/driver.yaml")
    limits = limits_of(driver, servo_model("XM430-W350"), None)
    start = time.perf_counter()
    points = list(scan(MarginTask(limits=limits), DEFAULTS.map, DEFAULTS.scan.margins()))
    seconds = time.perf_counter() - start
    cliff = find_cliff(points)
    told = f"cliff at {1e3 * cliff.margin:.1f} mm" if cliff else "no cliff"
    how = f"{len(points)} margins, every moving gait's force and power looked at; {told}"
    return Row("margin scan under a servo's limits", f"{seconds:.1f} s", "60 s", how)


def _cold_row() -> Row:
    with tempfile.TemporaryDirectory() as folder:
        start = time.perf_counter()
        front = make_front(ParameterFile(), DEFAULTS, 1, Cache.at(Path(folder)), lambda _: None)
        seconds = time.perf_counter() - start
    how = f"scan, front, success of {len(front.predictions)} gaits over {DEFAULTS.samples} draws"
    return Row("from parameters to a served front", f"{seconds:.1f} s", "60 s", how)


def run() -> list[Row]:
    """Measures."""
    certify(0.0, 1)  # compiles the kernel, if it is not in its cache
    return [_share_row(), _scan_row(0.2952), _scan_row(0.2941), _limited_scan_row(), _cold_row()]
