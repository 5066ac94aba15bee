# SPDX-License-Identifier: Apache-2.0
"""Draws the growth of the simulator's cost: ``python -m benchmarks.plot_simulator_cost FILE``."""

from __future__ import annotations

import sys

import matplotlib as mpl
import numpy as np

from benchmarks.report import cpu_time, machine
from worm_model.batch import evaluate_gaits

mpl.use("Agg")
from matplotlib import pyplot as plt


def main(path: str) -> None:
    """Measures and draws."""
    rng = np.random.default_rng(0)
    stroke, frequency = rng.uniform(0.01, 0.09, 200), rng.uniform(0.08, 0.4, 200)
    cycles = np.array([5, 10, 20, 50, 100, 200, 500])
    by_cycles = [
        cpu_time(lambda n=n: evaluate_gaits(stroke, frequency, cycles=n), 3) for n in cycles
    ]
    counts = np.array([300, 1000, 3000, 10_000, 30_000, 100_000])
    boxes = [(rng.uniform(0.01, 0.09, n), rng.uniform(0.08, 0.4, n)) for n in counts]
    by_count = [cpu_time(lambda box=box: evaluate_gaits(*box), 3) for box in boxes]
    figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.8), layout="constrained")
    for axes, x, y in ((left, cycles, np.array(by_cycles) / 200 * 1e6), (right, counts, by_count)):
        axes.loglog(x, y, "o-", color="#0072B2", label="measured")
        axes.loglog(x, y[-1] / x[-1] * x, "--", color="#D55E00", label="proportional")
        axes.grid(which="both", color="0.9")
        axes.legend()
    left.set(xlabel="cycles of a gait", ylabel="processor time per gait (µs)")
    right.set(xlabel="gaits of five cycles", ylabel="processor time of the batch (s)")
    figure.suptitle(f"Cost grows linearly ({machine()})", fontsize=9)
    figure.savefig(path, dpi=120)


if __name__ == "__main__":
    main(sys.argv[1])
