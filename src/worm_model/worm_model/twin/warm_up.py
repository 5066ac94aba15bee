# SPDX-License-Identifier: Apache-2.0
"""Compilation of the kernel and the twin's core into their cache: ``python -m worm_model.twin.warm_up``.

The script prints the folder of the kernel's cache.
"""

import numpy as np

from worm_model.gait import FORWARD, Gait
from worm_model.parameters import PAPER
from worm_model.run import Activity, GaitStates, LengthSamples, PowerSamples, Run, TrackerSamples
from worm_model.simulation.actuation import length_change_of_command
from worm_model.simulation.batch import evaluate_gaits, sample_cycle
from worm_model.simulation.kernel import cache_directory
from worm_model.simulation.kernel.grooves import EVEN
from worm_model.simulation.kernel.march import SAMPLE_COLUMNS
from worm_model.simulation.kernel.sampled_energy import sampled_energy
from worm_model.simulation.kernel.whole_run import run_from_rest
from worm_model.simulation.rows import parameter_rows
from worm_model.simulation.simulator import Locomotion, evaluate_gait, play_gait, simulate
from worm_model.twin.offline_replay import replay_run


def main() -> None:
    """Call the functions of kernel and core once, which compiles them into the cache."""
    _call_core()
    _call_kernel()


def _call_core() -> None:
    replay_run(_recording(Gait(0.07, 0.2)), PAPER)


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
    play_gait(gait, PAPER, model.start(), [0.1])
    length_change_of_command([0.0, 0.1], [0.0, -0.01], PAPER)
    samples, still, row = np.zeros((1, SAMPLE_COLUMNS)), np.zeros((4, 1)), parameter_rows(PAPER)[0]
    two = np.arange(2.0)
    sampled_energy(two, two, two, 1.0, False, 1.0, 1.0, two)
    run_from_rest(two, still, row, 1.0, 0.0, 0.0, EVEN, EVEN, samples)


def _recording(gait: Gait) -> Run:
    """Return a recording of half a second of a gait."""
    stamp = 10**9 + 10**7 * np.arange(50)
    command = np.array([gait.command(time) for time in (stamp - 10**9) * 1e-9])
    length = PAPER.initial_length + command
    onset, one = np.array([10**9]), np.ones(1)
    return Run(
        origin=10**9,
        commanded=LengthSamples(stamp, length, command),
        measured=LengthSamples(stamp, length, command),
        tracker=TrackerSamples(stamp, 0.0 * length, length),
        power=PowerSamples(stamp, 0 * stamp, 12.0 * one, 0.1 * one, 0.0 * length),
        gait_state=GaitStates(
            stamp=onset,
            state=np.array([Activity.RUNNING]),
            stroke=gait.stroke * one,
            frequency=gait.frequency * one,
            direction=np.array([FORWARD]),
            margin=0.0 * one,
            onset=onset,
        ),
    )


if __name__ == "__main__":
    main()
    print(cache_directory())  # noqa: T201 - for the script worm
