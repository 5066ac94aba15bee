# SPDX-License-Identifier: Apache-2.0
"""Probability that a cycle keeps its grooves, from the margins of a few cycles.

The margin of a cycle is normal about a mean that depends linearly on the gait, with a scatter along the pipe. It
depends on the distance between the grooves of both fins, the sum of the pitches below the body. So cycles at nearby
places have similar margins, and a run of five cycles knows the margin at its place better than along the pipe. Mean and
scatter are uncertain, so the probability is integrated over their posterior, and its 95 % interval is that of the
posterior.
`SHARED_SD_M` is an error of the measurement that does not average out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import ndtr, ndtri

from worm_model.arrays import Array
from worm_model.margin.cycle_margin import SHARED_SD_M

# Prior of the scatter: its median in m, and the standard deviation of its logarithm. A pitch that varies by 1 % gives
# 0.5 mm, one that varies by 1.5 % gives 0.8 mm.
_SCATTER_M, _LOG_SCATTER_SD = 0.0004, 0.3
# share of the variance that differs from cycle to cycle, such as that of the threshold
_OF_CYCLE = 0.2
_BODY_M = 0.26  # distance from which margins are independent: the usual length of the body
_SCATTERS = _SCATTER_M * np.exp(np.linspace(-3.0, 6.0, 24) * _LOG_SCATTER_SD)
_NODES = ndtri((np.arange(24) + 0.5) / 24)  # of a normal distribution, of equal weight


@dataclass(frozen=True)
class Probability:
    """Probability and its 95 % interval."""

    value: float
    low: float
    high: float

    def __str__(self) -> str:
        return f"{self.value:.3f} ({self.low:.3f} to {self.high:.3f})"


@dataclass(frozen=True)
class MarginBelief:
    """Posterior of the margin of a gait's next cycle: for each scatter its weight, and mean and sd of the mean margin.

    Attributes:
        scatter: standard deviation of the margin from cycle to cycle, m, shape (k,).
        weight: posterior probability of each scatter, shape (k,).
        mean, sd: mean of the mean margin and its standard deviation, m, shape (k,).
    """

    scatter: Array
    weight: Array
    mean: Array
    sd: Array

    def __str__(self) -> str:
        return f"{1e3 * self.expected:.1f} ± {1e3 * self.expected_scatter:.1f} mm"

    @property
    def expected(self) -> float:
        """Expected margin, m."""
        return float(self.weight @ self.mean)

    @property
    def expected_scatter(self) -> float:
        """Expected scatter, m."""
        return float(self.weight @ self.scatter)

    @property
    def expected_sd(self) -> float:
        """Standard deviation of the expected margin, m."""
        variance = self.weight @ (self.sd**2 + (self.mean - self.expected) ** 2)
        return math.sqrt(float(variance))

    @property
    def chance(self) -> float:
        """Probability that the next margin is positive."""
        kept, weight = self.keeps()
        return float(kept @ weight)

    def keeps(self) -> tuple[Array, Array]:
        """Return the probabilities that a margin is positive, and their weights, shape (n,) each."""
        means = self.mean[:, np.newaxis] + self.sd[:, np.newaxis] * _NODES
        kept = ndtr(means / self.scatter[:, np.newaxis])
        weight = np.repeat(self.weight / _NODES.size, _NODES.size)
        return kept.ravel(), weight


@dataclass(frozen=True)
class MarginModel:
    """Margins of cycles (n,) in m with standard deviations, and terms (n, p) on which they depend linearly.

    ``place`` (n,) is the position of the rear module in each cycle, m. ``expected`` and ``spread`` (p,) are the priors
    of the coefficients.
    """

    margin: Array
    sd: Array
    place: Array
    terms: Array
    expected: Array
    spread: Array

    def at(self, terms: ArrayLike) -> MarginBelief:
        """Return the posterior for the terms (p,) of one gait."""
        wanted = np.asarray(terms, dtype=float)
        weight, coefficients, root = self._posterior
        mean = coefficients @ wanted
        sd = np.hypot(np.linalg.norm(root @ wanted, axis=1), SHARED_SD_M)
        return MarginBelief(_SCATTERS, weight, mean, sd)

    @cached_property
    def _posterior(self) -> tuple[Array, Array, Array]:
        """Weight of each scatter (k,), mean (k, p) and root of the covariance (k, p, p) of the coefficients."""
        rest = self.margin - self.terms @ self.expected
        scaled = self.terms * self.spread
        apart = np.abs(self.place[:, np.newaxis] - self.place)
        alike = (1.0 - _OF_CYCLE) * np.maximum(1.0 - apart / _BODY_M, 0.0)
        alike += _OF_CYCLE * np.eye(rest.size)
        log_weight = -0.5 * (np.log(_SCATTERS / _SCATTER_M) / _LOG_SCATTER_SD) ** 2
        noise = _SCATTERS[:, np.newaxis, np.newaxis] ** 2 * alike + np.diag(self.sd**2)
        weighted = np.linalg.solve(noise, np.column_stack([scaled, rest])[np.newaxis])
        precision = np.eye(self.spread.size) + scaled.T @ weighted[:, :, :-1]
        moment = scaled.T @ weighted[:, :, -1:]
        solved = np.linalg.solve(precision, moment)
        log_weight -= 0.5 * (
            np.linalg.slogdet(noise)[1]
            + np.linalg.slogdet(precision)[1]
            + weighted[:, :, -1] @ rest
            - (moment * solved).sum(axis=(1, 2))
        )
        means = self.expected + self.spread * solved[:, :, 0]
        roots = np.linalg.inv(np.linalg.cholesky(precision)) * self.spread
        weight = np.exp(log_weight - log_weight.max())
        return weight / weight.sum(), means, roots


def belief_of(margin: Array, sd: Array, place: Array) -> MarginBelief:
    """Return the posterior for the margins (n,) of cycles of one gait, their standard deviations and places, m."""
    one = np.ones((margin.size, 1))
    return MarginModel(margin, sd, place, one, np.zeros(1), np.array([0.1])).at([1.0])


def keeps_probability(*fins: MarginBelief) -> Probability:
    """Return the probability that a cycle keeps the grooves of all fins, which are independent."""
    value, weight = np.ones(1), np.ones(1)
    for fin in fins:
        kept, own = fin.keeps()
        value, weight = np.outer(value, kept).ravel(), np.outer(weight, own).ravel()
    order = np.argsort(value)
    total = np.cumsum(weight[order])
    low, high = (float(value[order][np.searchsorted(total, q)]) for q in (0.025, 0.975))
    mean = min(float(value @ weight), 1.0)
    # A long tail can move the mean beyond a quantile.
    return Probability(mean, min(low, mean), max(high, mean))
