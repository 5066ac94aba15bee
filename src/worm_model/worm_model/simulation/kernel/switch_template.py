# SPDX-License-Identifier: Apache-2.0
"""Compiled fit of the template of a switch (`worm_model.margin.fin_switch`) to the samples of many windows."""

from __future__ import annotations

from typing import Any

import numpy as np

from worm_model.arrays import Array
from worm_model.simulation.kernel.compiled import compiled, entry

TERMS = 5  # of the template


@entry
def log_evidence(
    samples: Array,
    moment: Array,
    now: Array,
    windows: Any,
    time_constant: float,
    noise: float,
    models: Array,
) -> Array:
    """Return the log evidence (n, m) of linear models with normal priors, without terms common to all models.

    The terms are an offset, the travel that is left until the moment, the travel after the turning point, the travel
    since the moment, and the jump at it. Their sum is the position of the holding module relative to its mean.

    Args:
        samples: time s, travel m, travel since the turning point m, position of the holding module m; shape (4, k).
        moment: possible times of a switch, s, shape (n,).
        now: travel at each of them, m, shape (n,).
        windows: samples of each window: the first one, and the one after the last; shape (2, n).
        time_constant: time constant of the jump, s.
        noise: standard deviation of the position, m.
        models: prior means of the five coefficients and their standard deviations, shape (m, 2, 5). With 0, a term has
            its expected coefficient.
    """
    time, travel, turned, position = samples
    found = np.empty((moment.size, len(models)))
    row = np.empty(TERMS + 1)
    for k in range(moment.size):
        first, last = windows[0, k], windows[1, k]
        mean = position[first:last].sum() / max(last - first, 1)
        products = np.zeros((TERMS + 1, TERMS + 1))
        for j in range(first, last):
            since = max(time[j] - moment[k], 0.0)
            row[0], row[1], row[2] = 1.0, now[k] - travel[j], turned[j]
            row[3] = -row[1] if since > 0.0 else 0.0
            row[4] = -np.expm1(-since / time_constant)
            row[5] = position[j] - mean
            for a in range(TERMS + 1):
                for b in range(TERMS + 1):
                    products[a, b] += row[a] * row[b] / noise**2
        for m in range(len(models)):
            found[k, m] = _of_model(products, models[m, 0], models[m, 1])
    return found


@compiled
def _of_model(products: Array, expected: Array, spread: Array) -> float:
    """Return the log evidence of a model from the products of terms and position."""
    # products of the scaled terms and of the rest; only the lower triangle is used
    inner = np.zeros((TERMS + 1, TERMS + 1))
    inner[TERMS, TERMS] = products[TERMS, TERMS]
    for a in range(TERMS):
        rest = products[TERMS, a]
        for b in range(TERMS):
            rest -= products[a, b] * expected[b]
            inner[a, b] = spread[a] * spread[b] * products[a, b]
        inner[a, a] += 1.0
        inner[TERMS, a] = spread[a] * rest
        inner[TERMS, TERMS] -= expected[a] * (products[TERMS, a] + rest)
    log_determinant = 0.0
    for a in range(TERMS):  # elimination leaves what the terms do not explain in the corner
        log_determinant += np.log(inner[a, a])
        for b in range(a + 1, TERMS + 1):
            for c in range(a + 1, b + 1):
                inner[b, c] -= inner[b, a] * inner[c, a] / inner[a, a]
    return -0.5 * (inner[TERMS, TERMS] + log_determinant)
