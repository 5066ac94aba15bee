# SPDX-License-Identifier: Apache-2.0
"""Two gaits in one session of the virtual robot: the second begins with fins that the first has deflected."""

from dataclasses import replace

import numpy as np
from recorded_run import GAIT
from twin_samples import run_of_rows
from virtual_session import Session

from worm_model.run import Run

CYCLES = 4, 5


def joined_session() -> Run:
    """Return one recording of `GAIT`, played twice."""
    session = Session()
    for cycles in CYCLES:
        session.run(GAIT, cycles)
    run = run_of_rows(session.rows)
    cycles = np.array([0, *CYCLES])[run.gait_state.run]
    return replace(run, gait_state=replace(run.gait_state, cycles=cycles))
