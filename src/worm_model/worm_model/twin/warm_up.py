# SPDX-License-Identifier: Apache-2.0
"""Compilation of the kernel and the twin's core into their cache: ``python -m worm_model.twin.warm_up``.

The script prints the folder of the kernel's cache.
"""

from dataclasses import astuple

import numpy as np

from worm_model.gait import FORWARD, Gait
from worm_model.parameters import PAPER
from worm_model.run import Activity
from worm_model.simulation.actuation import length_change_of_command
from worm_model.simulation.batch import evaluate_gaits, sample_cycle
from worm_model.simulation.kernel import cache_directory
from worm_model.simulation.kernel.grooves import EVEN
from worm_model.simulation.kernel.march import SAMPLE_COLUMNS
from worm_model.simulation.kernel.sampled_energy import sampled_energy
from worm_model.simulation.kernel.switch_template import TERMS, log_evidence
from worm_model.simulation.kernel.whole_run import run_from_rest
from worm_model.simulation.rows import parameter_rows
from worm_model.simulation.simulator import Locomotion, evaluate_gait, simulate
from worm_model.twin.data.samples import SampleKind, SampleRows, sample_rows
from worm_model.twin.twin import Twin


def main() -> None:
    """Call the functions of kernel and core once, which compiles them into the cache."""
    _call_core()
    _call_kernel()


def _call_core() -> None:
    twin = Twin()
    twin.advance(twin.start(), _samples(Gait(0.07, 0.2)), to_the_end=True)


def _call_kernel() -> None:
    gait = Gait(0.07, 0.2)
    evaluate_gait(gait)
    evaluate_gaits([0.07, 0.08], 0.2)
    sample_cycle([0.07], [0.2], FORWARD, PAPER, 0, [0.5])
    evaluate_gait(gait, PAPER.replace(rear_dry_friction=0.1))
    trajectory = simulate(gait, cycles=1)
    trajectory.at([0.0])
    trajectory.events()
    model = Locomotion()
    model.follow(model.start(), [0.1, 0.2], [-0.001, -0.002])
    length_change_of_command([0.0, 0.1], [0.0, -0.01], PAPER)
    samples, still, row = np.zeros((1, SAMPLE_COLUMNS)), np.zeros((4, 1)), parameter_rows(PAPER)[0]
    two = np.arange(2.0)
    sampled_energy(two, two, two, 1.0, False, 1.0, 1.0, two)
    run_from_rest(two, still, row, 1.0, 0.0, 0.0, EVEN, EVEN, samples)
    moment, windows = np.zeros(1), np.zeros((2, 1), np.int64)
    log_evidence(np.zeros((4, 1)), moment, moment, windows, 1.0, 1.0, np.zeros((1, 2, TERMS)))


def _samples(gait: Gait) -> SampleRows:
    """Return the samples of half a second of a gait."""
    stamp = 10**9 + 10**7 * np.arange(50)
    command = np.array([gait.command(time) for time in (stamp - 10**9) * 1e-9])
    length = PAPER.initial_length + command
    begin = sample_rows(SampleKind.GAIT, stamp[:1], *np.array([astuple(gait)], float).T)
    begin["state"], begin["onset"] = Activity.RUNNING, stamp[0]
    parts = [
        begin,
        sample_rows(SampleKind.COMMAND, stamp, command),
        sample_rows(SampleKind.LENGTH, stamp, length),
        sample_rows(SampleKind.POSITION, stamp, 0.0 * length, length),
        sample_rows(SampleKind.POWER, stamp, 0.0 * length),
    ]
    rows = np.concatenate(parts)
    return rows[np.argsort(rows["stamp"], kind="stable")]


if __name__ == "__main__":
    main()
    print(cache_directory())  # noqa: T201 - for the script worm
