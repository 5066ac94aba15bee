# SPDX-License-Identifier: Apache-2.0
"""Grooves of a pipe with individual thresholds and stiffnesses, whose means are the parameters of the robot.

The identification estimates the differences between grooves. All other modules of this package assume even grooves,
which are alike.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from worm_model.simulation.kernel.compiled import inlined
from worm_model.simulation.kernel.mode import Constants, Fin, Motion

# Columns of a row of grooves
THRESHOLD, STIFFNESS = range(2)
GROOVE_COLUMNS = 2
FIRST_GROOVE = 2  # row of the groove in which a module starts
#: grooves that do not differ
EVEN = np.zeros((1, GROOVE_COLUMNS))


class Grooves(NamedTuple):
    """Grooves that each module passes, an array (m, GROOVE_COLUMNS) with one groove per row, in the order of +x.

    A row contains the differences from the robot's parameters: that of the threshold in m, and the relative one of the
    stiffness. A module starts in row FIRST_GROOVE, which is groove 0 for the rear module and groove ``front_start`` for
    the front module. Grooves before the first row and after the last row are like these rows.
    """

    rear: np.ndarray
    front: np.ndarray
    front_start: int


@inlined
def _fin_in(groove: int, grooves: np.ndarray, fin: Fin) -> Fin:
    row = min(max(groove + FIRST_GROOVE, 0), grooves.shape[0] - 1)
    factor = 1.0 + grooves[row, STIFFNESS]
    return Fin(
        factor * fin.stiffness_below,
        factor * fin.stiffness_above,
        fin.threshold + grooves[row, THRESHOLD],
    )


@inlined
def in_grooves(even: Constants, motion: Motion, grooves: Grooves) -> Constants:
    """Return the constants of a robot whose fins sit in the grooves of a motion's anchors.

    ``even`` are the constants in grooves that do not differ.
    """
    return Constants(
        even.body,
        _fin_in(motion.rear_groove, grooves.rear, even.rear_fin),
        _fin_in(motion.front_groove - grooves.front_start, grooves.front, even.front_fin),
        even.resistance,
    )
