# SPDX-License-Identifier: Apache-2.0
"""Travel error: measured minus predicted margin of a run's worst cycle, in m of the switching threshold.

A robot is not the model. With the same command, the travel of its fins differs from the model's, by an amount that no
parameter of the model describes. This amount decides whether a gait keeps its grooves.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from worm_msgs.robot_parameters import TravelError

#: Travel error of a robot that no run has measured. Compared with robots that the model does not contain
#: (tests/helpers/foreign_robot.py, 24 robots at 0.1, 0.15 and 0.2 Hz, model with their own parameters), it was −0.7 mm
#: in the mean, 1.1 mm root mean square and −3.0 mm at worst. With 1.5 mm, gaits for a probability of 95 % kept their
#: grooves on 95 to 98 % of 40 robots; with 1.2 mm on 88 to 90 %, and with 0 on 53 to 58 %.
PRIOR = TravelError(0.0, 1.5e-3)
_NORMAL_975 = 1.959963984540054  # 97.5 % quantile of the standard normal distribution


def travel_error(measured_margins: ArrayLike, predicted_margins: ArrayLike) -> TravelError:
    """Return the travel error of the next run, from the margins (n,) in m that were measured and predicted in n runs.

    A margin that is NaN was not measured. ``sd`` contains the scatter of the runs and the error of their mean. It is
    the standard deviation of the normal distribution whose central 95 % are those of Student's distribution. It is at
    most that of `PRIOR` and of the scatter together, and that of `PRIOR` after a single run, which shows no scatter.
    """
    difference = np.subtract(measured_margins, predicted_margins, dtype=float).ravel()
    difference = difference[np.isfinite(difference)]
    if not difference.size:
        return PRIOR
    mean, runs = float(difference.mean()), difference.size
    if runs == 1:
        return TravelError(mean, PRIOR.sd)
    from scipy.stats import t  # here, because the import takes a second

    scatter = float(difference.std(ddof=1))
    width = scatter * math.sqrt(1.0 + 1.0 / runs) * float(t.ppf(0.975, runs - 1)) / _NORMAL_975
    return TravelError(mean, min(width, math.hypot(PRIOR.sd, scatter)))
