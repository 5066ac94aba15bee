# SPDX-License-Identifier: Apache-2.0
"""Stages 2 and 3: the bellows and the fin."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from random_cases import examples

from worm_model.errors import IdentificationError
from worm_model.identification.bellows import fit_bellows
from worm_model.identification.fin import fit_fin

X = np.linspace(-0.012, 0.012, 97)
COMPRESSION = np.linspace(0.0, 0.07, 36)
FIN = (0.00753, 1833.1, 442.0)


def fin_force(x, clearance=FIN[0], engaged=FIN[1], disengaged=FIN[2]):
    low = engaged * np.minimum(x + 0.5 * clearance, 0.0)
    return low + disengaged * np.maximum(x - 0.5 * clearance, 0.0)


def noise(seed, size, scale):
    return np.random.default_rng(seed).normal(0.0, scale, size)


@pytest.mark.parametrize(("correlation", "least"), [(0.0, 0.92), (0.5, 0.88)])
def test_the_bellows_interval_covers_with_its_probability(correlation, least):
    """Also where residuals are correlated, as under hysteresis."""
    fits = []
    for seed in range(300):
        white = noise(seed, 36, 0.3)
        wandering = white.copy()
        for k in range(1, 36):
            wandering[k] = correlation * wandering[k - 1] + np.sqrt(1.0 - correlation**2) * white[k]
        fits.append(fit_bellows(COMPRESSION, 968.8 * COMPRESSION + wandering))
    covered = np.mean([fit.stiffness.low <= 968.8 <= fit.stiffness.high for fit in fits])
    assert least <= covered <= 0.98


@pytest.mark.parametrize(
    ("fit", "x", "y", "reason"),
    [
        (fit_bellows, COMPRESSION[:3], COMPRESSION[:3], "usable points"),
        (fit_bellows, np.zeros(9), np.arange(9.0), "usable points"),
        (fit_bellows, COMPRESSION, -900.0 * COMPRESSION, "decreases with compression"),
        (fit_fin, X[:6], fin_force(X[:6]), "both sides"),
        (fit_fin, np.abs(X), fin_force(np.abs(X)), "both sides"),
        (fit_fin, X, fin_force(X, FIN[0], 1000.0, 1000.0), "which side engages"),
    ],
)
def test_a_test_without_information_is_rejected(fit, x, y, reason):
    with pytest.raises(IdentificationError, match=reason):
        fit(x, y)


def test_all_of_the_fins_intervals_cover_with_their_probability():
    fits = [fit_fin(X, fin_force(X) + noise(s, 97, 0.12)) for s in range(150)]
    for index, name in enumerate(("clearance", "engaged_stiffness", "disengaged_stiffness")):
        estimates = [getattr(fit, name) for fit in fits]
        assert 0.9 <= np.mean([e.low <= FIN[index] <= e.high for e in estimates]) <= 0.99


def test_neither_outliers_nor_a_zero_that_is_off_move_clearance_and_stiffness():
    force = fin_force(X) + noise(4, 97, 0.1)
    spoilt = force.copy()
    spoilt[[5, 50, 90]] += [8.0, -6.0, 7.0]
    assert fit_fin(X, spoilt).values == pytest.approx(fit_fin(X, force).values, rel=0.02)
    shifted = fit_fin(X + 0.0012, force)
    assert shifted.centre == pytest.approx(0.0012, abs=2e-4)
    assert shifted.values == pytest.approx(FIN, rel=0.04)


@examples(40)
@given(
    clearance=st.floats(0.002, 0.015),
    engaged=st.floats(900.0, 4000.0),
    share=st.floats(0.1, 0.7),
    side=st.sampled_from([1, -1]),
    sign=st.sampled_from([1, -1]),
)
def test_any_fin_is_found_with_any_sign_convention(clearance, engaged, share, side, sign):
    force = fin_force(X, clearance, engaged, share * engaged) + noise(6, 97, 0.01)
    fit = fit_fin(side * X, sign * force)
    assert fit.engages == -side
    assert fit.values == pytest.approx([clearance, engaged, share * engaged], rel=0.03)
    assert fit.force_at(fit.displacement) == pytest.approx(fit.force, abs=0.05)


@pytest.mark.parametrize("centre", [0.0, 0.0003])
def test_a_fin_test_without_noise_is_found_exactly(centre):
    fit = fit_fin(X, fin_force(X - centre))
    assert fit.values == pytest.approx(FIN, rel=1e-9)
    assert fit.clearance.low == pytest.approx(fit.clearance.high, rel=1e-6)
    assert fit.centre == pytest.approx(centre, abs=1e-9)
