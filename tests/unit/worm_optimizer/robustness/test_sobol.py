# SPDX-License-Identifier: Apache-2.0
"""Sobol indices, compared with closed forms."""

import numpy as np
import pytest

from worm_optimizer.commands.sensitivity import warnings_of
from worm_optimizer.robustness.sensitivity import indices_of, saltelli_sample

RANDOM = saltelli_sample(3, 1024, 3)


def test_the_ishigami_function_has_its_indices():
    x = np.pi * (2.0 * RANDOM - 1.0)
    values = np.sin(x[:, 0]) + 7.0 * np.sin(x[:, 1]) ** 2 + 0.1 * x[:, 2] ** 4 * np.sin(x[:, 0])
    found = indices_of(values, 3, 1)
    # T. Ishigami and T. Homma, ISUMA 1990, a = 7, b = 0.1
    assert found.first == pytest.approx([0.3139, 0.4424, 0.0], abs=0.04)
    assert found.total == pytest.approx([0.5576, 0.4424, 0.2437], abs=0.04)
    assert np.all(found.first_bounds[0] <= found.first)
    assert np.all(found.first <= found.first_bounds[1])
    assert found.mean == pytest.approx(3.5, abs=0.1)


def test_a_constant_and_a_missing_value_have_no_indices():
    for values in (
        np.ones(len(RANDOM)),
        np.where(np.arange(len(RANDOM)) == 7, np.nan, RANDOM[:, 0]),
    ):
        found = indices_of(values, 3, 1)
        assert np.all(np.isnan([found.first, found.total]))
        assert warnings_of("speed", found, ("a", "b", "c")) == []


def test_a_total_index_below_the_first_is_reported():
    design = saltelli_sample(2, 2, 3)
    values = design[:, 0] + design[:, 1]
    few = indices_of(values, 2, 1)
    assert few.inconsistent.size
    (text,) = warnings_of("speed", few, ("a", "b"))
    assert all(("a", "b")[k] in text for k in few.inconsistent)
