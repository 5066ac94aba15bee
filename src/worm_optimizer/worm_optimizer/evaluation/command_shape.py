# SPDX-License-Identifier: Apache-2.0
"""Shapes of the commanded contraction: all fields of a waveform except stroke and frequency."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from worm_model.arrays import Array
from worm_msgs.gait import GAIT_DEFAULTS, SHAPE, Gait, Profile, peak_rate

Shapes = NDArray[np.void]  # structured array with the fields of SHAPE_ROW

SHAPE_ROW = np.dtype([(name, np.float64) for name in SHAPE])
#: shape of the paper's sinusoid, an array without dimensions
SINUSOID: Shapes = np.array(tuple(GAIT_DEFAULTS[name] for name in SHAPE), SHAPE_ROW)


def fields_of(shape: Shapes) -> dict[str, Any]:
    """Return the fields of shapes by name. Each field has the dimensions of ``shape``."""
    return {name: shape[name] for name in SHAPE}


def shapes_of(count: int, **fields: ArrayLike) -> Shapes:
    """Return ``count`` shapes of the paper's sinusoid, in which the given ``fields`` replace the default values.

    Each field is a scalar or has shape (count,). The pretension is in m, the other fields have no unit.
    """
    shape = np.full(count, SINUSOID)
    for name, values in fields.items():
        shape[name] = values
    return shape


def shapes_of_gaits(gaits: Iterable[Gait]) -> Shapes:
    """Return the command shapes of gaits."""
    chosen = list(gaits)
    names = SHAPE_ROW.names or ()
    return shapes_of(len(chosen), **{name: [getattr(g, name) for g in chosen] for name in names})


def peak_rates(shape: Shapes) -> Array:
    """Return the largest commanded cable speed of shapes, divided by stroke times frequency."""
    rates = peak_rate(shape["profile"], shape["contraction_share"], shape["ramp_share"])
    return np.asarray(rates)


def pull_rate(shape: Shapes, phases: Array) -> Array:
    """Return the speed at which shapes (n,) wind up the cable, divided by stroke times frequency, shape (n, m).

    ``phases`` (n, m) are times since the beginning of the cycle, divided by its period. The speed is 0 while the body
    extends.
    """
    share, ramp = shape["contraction_share"][:, np.newaxis], shape["ramp_share"][:, np.newaxis]
    part = np.minimum(phases / share, 1.0)
    cosine = np.where(part < 1.0, 0.5 * np.pi * np.sin(np.pi * part), 0.0)  # sin(π) > 0 in floats
    trapezoid = np.minimum(1.0, np.minimum(part, 1.0 - part) / ramp) / (1.0 - ramp)
    is_cosine = shape["profile"][:, np.newaxis] == Profile.COSINE
    return np.where(is_cosine, cosine, trapezoid) / share


def sample_phases(shape: Shapes, count: int) -> Array:
    """Return the phases at which cycles of shapes (n,) are sampled, ascending, shape (n, count).

    ``count`` is a multiple of 8. Half of the phases lie in the contraction, half in the extension. In a trapezoid, each
    ramp has a quarter of the phases of its half, and the steady part has the other two quarters. The ends of the ramps,
    where force and power are often extreme, are among the phases. The sampled extremes are therefore continuous
    functions of the shape.
    """
    share, ramp = shape["contraction_share"][:, np.newaxis], shape["ramp_share"][:, np.newaxis]
    part = np.arange(count // 2) / (count // 2)
    ramped = np.select(
        [part < 0.25, part < 0.75],
        [4.0 * part * ramp, ramp + (2.0 * part - 0.5) * (1.0 - 2.0 * ramp)],
        1.0 - 4.0 * (1.0 - part) * ramp,
    )
    is_cosine = shape["profile"][:, np.newaxis] == Profile.COSINE
    half = np.where(is_cosine, part, ramped)
    return np.hstack([half * share, share + half * (1.0 - share)])
