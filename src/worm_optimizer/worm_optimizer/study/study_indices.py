# SPDX-License-Identifier: Apache-2.0
"""Sobol indices of the results of a study with a Saltelli sample. They show which sampled quantities matter."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from worm_optimizer.study.plan import SALTELLI, Study
from worm_optimizer.study.results import point_table
from worm_optimizer.study.sobol import Indices, indices_of
from worm_optimizer.study.summary import figures_of


def study_indices(path: Path, study: Study) -> Mapping[str, Indices]:
    """Return the indices of each result on the study's page, by name of the result; empty without a Saltelli sample.

    Each sampled quantity is uniformly distributed over its range. The indices of a result are NaN if a point lacks it.
    """
    if not study.ranges or study.sample.method != SALTELLI:
        return {}
    with point_table(path) as data:
        columns, _ = figures_of(data.load(), study)
    inputs = len(study.ranges)
    return {column.name: indices_of(column.values, inputs, study.sample.seed) for column in columns}
