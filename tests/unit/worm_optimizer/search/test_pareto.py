# SPDX-License-Identifier: Apache-2.0
"""The front, compared with brute force."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from worm_optimizer.evaluation.task import Points
from worm_optimizer.search.pareto import front_of, non_dominated

# Few distinct values, so that ties in one or both objectives are common.
SPEEDS = st.integers(0, 8).map(lambda k: 1e-3 * k)
POWERS = st.integers(1, 8).map(float)
CLOUDS = st.lists(st.tuples(SPEEDS, POWERS), min_size=1, max_size=30)


def cloud(rows, violation=None) -> Points:
    speed, power = np.array(rows, dtype=float).T
    n = len(rows)
    return Points(
        *(np.full(n, 0.07), speed / 0.0173, speed, power, np.ones(n, dtype=np.int64)),
        np.zeros(n) if violation is None else np.asarray(violation, dtype=float),
    )


@given(CLOUDS)
def test_the_front_is_what_nothing_betters(rows):
    kept = [rows[k] for k in non_dominated(*np.array(rows).T)]
    better = {
        (v, p)
        for v, p in rows
        if not any((w >= v and q <= p and (w, q) != (v, p)) for w, q in rows)
    }
    assert set(kept) == better
    assert len(kept) == len(better)
    assert kept == sorted(kept)


def test_gaits_that_violate_a_constraint_are_not_on_the_front():
    front = front_of(cloud([(0.001, 1.0), (0.009, 0.5), (0.002, 2.0)], violation=[0.0, 1.0, 0.0]))
    assert front.speed.tolist() == [0.001, 0.002]
