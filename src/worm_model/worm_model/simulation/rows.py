# SPDX-License-Identifier: Apache-2.0
"""Parameters and gaits as rows of structured arrays, the form in which the compiled kernel reads them.

The columns are the fields of `Parameters` and `Gait`, under their names, so that a new field is a column of every
batch without further ado. All columns are float64; what is true or false is 1 or 0.
"""

from __future__ import annotations

import dataclasses
from operator import attrgetter

import numpy as np
from numpy.typing import NDArray

from worm_model.gait import GAIT_DEFAULTS, Gait, GaitError
from worm_model.parameters import ParameterError, Parameters

Rows = NDArray[np.void]

PARAMETER_ROW, GAIT_ROW = (
    # records, so that a row has its columns as attributes in Python too, where the kernel may be run uncompiled
    np.dtype((np.record, [(row.name, np.float64) for row in dataclasses.fields(kind)]))
    for kind in (Parameters, Gait)
)

_PARAMETERS = attrgetter(*(row.name for row in dataclasses.fields(Parameters)))
_GAIT = attrgetter(*(row.name for row in dataclasses.fields(Gait)))


def parameter_rows(parameters: Parameters) -> Rows:
    """Return the values as the one row of an array (1,) of PARAMETER_ROW."""
    rows = np.array([_PARAMETERS(parameters)], PARAMETER_ROW)
    check_simulated(np.zeros(0, GAIT_ROW), rows)
    return rows


def gait_rows(gait: Gait) -> Rows:
    """Return a gait as the one row of an array (1,) of GAIT_ROW."""
    rows = np.array([_GAIT(gait)], GAIT_ROW)
    check_simulated(rows, np.zeros(0, PARAMETER_ROW))
    return rows


def check_simulated(gaits: Rows, parameters: Rows) -> None:
    """Raise `InputError` if a gait or a parameter set (rows) has a value that the kernel does not simulate yet."""
    for name in ("pretension", "contraction_share", "profile", "ramp_share"):
        if np.any(gaits[name] != GAIT_DEFAULTS[name]):
            raise GaitError(f"{name}: only {GAIT_DEFAULTS[name]} can be simulated so far")
    for name in ("rear_load", "front_load"):
        if np.any(parameters[name] != 0.0):
            raise ParameterError(f"{name}: only 0 N can be simulated so far")
