# SPDX-License-Identifier: Apache-2.0
"""Runs of step functions, compared with the steps that they were made of."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from worm_optimizer.evaluation.runs import find_runs

TOLERANCE = 1e-7
STEPS = st.lists(st.integers(1, 79), min_size=0, max_size=6, unique=True).map(sorted)


@given(st.lists(STEPS, min_size=1, max_size=4), st.data())
def test_every_step_between_neighbours_of_the_scan_is_located(columns, data):
    """The scan has a stroke between any two steps, so that no run is missed."""
    steps = [1e-3 * np.array(each) + 3e-4 for each in columns]
    labels = [
        data.draw(st.lists(st.integers(0, 3), min_size=len(each) + 1, max_size=len(each) + 1))
        for each in steps
    ]

    def label(stroke, column):
        places = [np.searchsorted(steps[c], s) for s, c in zip(stroke, column, strict=True)]
        return np.array([labels[c][p] for c, p in zip(column, places, strict=True)])

    scan = np.tile(np.linspace(0.0, 0.08, 81), (len(steps), 1))
    runs = find_runs(label, scan, TOLERANCE)
    for column, (at, of) in enumerate(zip(steps, labels, strict=True)):
        real = np.flatnonzero(np.diff(of))
        mine = runs.column == column
        assert runs.label[mine].tolist() == [of[0], *(of[k + 1] for k in real)]
        assert runs.stepped[mine].tolist() == [False] + [True] * len(real)
        assert np.all(
            (runs.low[mine][1:] >= at[real]) & (runs.low[mine][1:] <= at[real] + TOLERANCE)
        )
        assert np.all((runs.high[mine][:-1] <= at[real]) & (runs.high[mine][-1] == 0.08))


def test_a_run_thinner_than_the_scan_next_to_a_step_is_found():
    def label(stroke, _):
        return np.select([stroke > 0.052, stroke > 0.0515, stroke > 0.0511], [2, 0, 2])

    runs = find_runs(label, np.linspace(0.01, 0.09, 41)[np.newaxis], TOLERANCE)
    assert runs.label.tolist() == [0, 2, 0, 2]
    assert np.allclose(runs.low, [0.01, 0.0511, 0.0515, 0.052], atol=TOLERANCE)


def test_without_columns_there_are_no_runs():
    runs = find_runs(lambda stroke, _: stroke.astype(int), np.empty((0, 5)), TOLERANCE)
    assert len(runs.column) == len(runs.low) == 0
