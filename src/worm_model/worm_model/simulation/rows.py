# SPDX-License-Identifier: Apache-2.0
"""Parameters and gaits as rows of structured arrays, the form in which the compiled kernel reads them.

The columns are the fields of `Parameters` and `Gait` and have the same names. A new field therefore becomes a column of
every batch. All columns are float64; True and False are 1 and 0.
"""

from __future__ import annotations

import dataclasses
from operator import attrgetter

import numpy as np
from numpy.typing import NDArray

from worm_model.gait import Gait
from worm_model.parameters import Parameters

Rows = NDArray[np.void]

PARAMETER_ROW, GAIT_ROW = (
    # Records have their columns as attributes in Python too, so that the kernel can be run uncompiled.
    np.dtype((np.record, [(row.name, np.float64) for row in dataclasses.fields(kind)]))
    for kind in (Parameters, Gait)
)

_PARAMETERS = attrgetter(*(row.name for row in dataclasses.fields(Parameters)))
_GAIT = attrgetter(*(row.name for row in dataclasses.fields(Gait)))


def parameter_rows(parameters: Parameters) -> Rows:
    """Return the parameters as an array (1,) of PARAMETER_ROW."""
    return np.array([_PARAMETERS(parameters)], PARAMETER_ROW)


def gait_rows(gait: Gait) -> Rows:
    """Return a gait as an array (1,) of GAIT_ROW."""
    return np.array([_GAIT(gait)], GAIT_ROW)
