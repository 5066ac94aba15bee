# SPDX-License-Identifier: Apache-2.0
"""Compiles the kernel into its cache, so that nothing compiles later: ``python -m worm_model.warm_up``."""

import numpy as np

from worm_model.actuation import length_change_of_command
from worm_model.batch import evaluate_gaits
from worm_model.gait import FORWARD, Gait
from worm_model.identification.locomotion import ALIKE, worm_of
from worm_model.kernel import dry_friction
from worm_model.parameters import PAPER
from worm_model.simulator import Locomotion, evaluate_gait, simulate


def main() -> None:
    """Calls every entry of the kernel once."""
    gait = Gait(0.07, 0.2)
    evaluate_gait(gait)
    evaluate_gaits([0.07, 0.08], 0.2)
    trajectory = simulate(gait, cycles=1)
    trajectory.at([0.0])
    trajectory.events()
    model = Locomotion()
    model.follow(model.start(), [0.1, 0.2], [-0.001, -0.002])
    length_change_of_command([0.0, 0.1], [0.0, -0.01], PAPER)
    samples = np.empty((2, dry_friction.SAMPLE_COLUMNS))
    dry_friction.slide(0.01, np.zeros(2), worm_of(PAPER, FORWARD), ALIKE, ALIKE, samples)


if __name__ == "__main__":
    main()
