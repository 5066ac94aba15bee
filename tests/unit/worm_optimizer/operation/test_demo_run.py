# SPDX-License-Identifier: Apache-2.0
"""The table of the demo about its run."""

import math
import re
from types import SimpleNamespace

import pytest

from worm_model.errors import RecordingError
from worm_optimizer.operation.demo_run import (
    Performance,
    compare,
    comparison_table,
    relative_difference,
)
from worm_optimizer.report.expectation import Band, Bands


def test_the_table_shows_differences_to_the_measurement():
    measured = Performance(0.005, 2.0, 50.0)
    table = comparison_table(measured, {"twin": Performance(0.0055, 1.9, 45.0)})
    lines = table.splitlines()
    assert "5.00 mm/s" in lines[1]
    assert "%" not in lines[1]
    cells = re.split(r"\s{2,}", lines[2])
    assert cells == ["twin", "5.50 mm/s", "+10.0 %", "1.90 W", "-5.0 %", "45.0", "-10.0 %"]


def test_a_missing_number_is_rejected_of_the_twin_too():
    seen, nothing = Band(1.0, 1.0, 1.0), Band(math.nan, math.nan, math.nan)
    gait = SimpleNamespace(early_end="", missing=(), twin=Bands(seen, nothing, nothing))
    with pytest.raises(RecordingError, match="the twin did not follow"):
        compare(gait, None)


def test_differences_of_nothing_are_not_numbers():
    assert math.isnan(relative_difference(1.0, 0.0))
    assert relative_difference(-0.9, -1.0) == pytest.approx(0.1)
