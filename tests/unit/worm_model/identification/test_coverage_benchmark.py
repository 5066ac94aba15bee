# SPDX-License-Identifier: Apache-2.0
"""Results of the coverage benchmark for robots that are covered, missed, not identifiable and rejected."""

from pathlib import Path

import pytest
from virtual_campaign import SHORT

from worm_model.identification.data.identification_errors import IdentificationError
from worm_model.identification.fits.estimate import Estimate, not_identifiable

ROOT = Path(__file__).resolve().parents[4]


@pytest.fixture
def coverage(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT))
    return pytest.importorskip("benchmarks.identification_coverage")


def case_of(coverage, seed, estimate):
    keys = coverage.IDENTIFIED
    return coverage.Case(
        seed, dict.fromkeys(keys, 2.0), dict.fromkeys(keys, estimate), verdict="roughly"
    )


def test_every_robot_counts_once_and_no_row_is_nan(coverage):
    cases = [
        case_of(coverage, 1, Estimate(2.1, 1.9, 2.3)),
        case_of(coverage, 2, Estimate(2.5, 2.3, 2.7)),
        case_of(coverage, 3, not_identifiable(2.0, "why")),
        coverage.Case(4, {}, {}, "nothing explains the motion"),
    ]
    first, verdicts, *rows = coverage.rows_of(cases, "robots", "fits")
    assert first.value == "1 of 4"
    assert verdicts.value == "3 roughly"
    assert [row.what for row in rows] == coverage.IDENTIFIED
    assert all(row.value == "1 of 2" and "nan" not in row.how for row in rows)
    assert coverage.row("gain", cases[2:], "robots").value == "no interval"
    assert "missed: initial_length" in coverage.comment(cases[1])
    assert "rejected: nothing" in coverage.comment(cases[3])


def test_a_robot_that_is_rejected_does_not_end_the_benchmark(coverage, monkeypatch):
    def reject(*_):
        raise IdentificationError("nothing explains the motion")

    monkeypatch.setattr(coverage, "identify", reject)
    campaign = coverage.virtual_campaign(7, SHORT[:1])
    monkeypatch.setattr(coverage, "virtual_campaign", lambda _seed: campaign)
    assert coverage.case(7).rejected == "nothing explains the motion"
