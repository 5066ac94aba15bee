# SPDX-License-Identifier: Apache-2.0
"""A recording through the twin, offline: arrays in, arrays out, the same each time."""

from __future__ import annotations

from worm_model.parameters import Parameters
from worm_model.run import Run
from worm_model.simulation.simulator import SimulationError
from worm_model.twin.by_sample import Replay, Series, replay_samples
from worm_model.twin.offline.follow import replay_columns
from worm_model.twin.offline.sample_timeline import Irregular
from worm_model.twin.twin_settings import DEFAULTS, TwinSettings

__all__ = ["Replay", "Series", "replay_run"]


def replay_run(run: Run, parameters: Parameters, settings: TwinSettings = DEFAULTS) -> Replay:
    """Let the twin follow a recording: all at once, or sample by sample where only that can tell."""
    try:
        return replay_columns(run, parameters, settings)
    except (Irregular, SimulationError):
        return replay_samples(run, parameters, settings)
